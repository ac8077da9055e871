"""The runs of a command: begun, gone on with, loaded."""

from contextlib import nullcontext
from pathlib import Path

from polyida.cli.places import free, make
from polyida.cli.screen.progress import bars
from polyida.cli.screen.streams import lines
from polyida.errors import InputError


def begun(scene, integrator, options, settings, out, overwrite):
    """(run, its file) of a scene with its options, by an integrator with its settings."""
    from polyida.run.solve import solve
    from polyida.study.comparison import chosen
    from polyida.study.comparison.compare import warm_up
    from polyida.study.comparison.job import load

    job, choice = load(scene, step=None if settings["step"] == "auto" else settings["step"], **options), chosen.choice(integrator)
    member = choice.made(job, **{name: value for name, value in settings.items() if value is not None})
    path = free(out, Path(f"{job.name}-{integrator.rpartition(':')[2]}.h5"), overwrite, lines)
    make(path.parent)
    with bars() as tell, job.code(), choice.code():
        tell("preparing kernels", None)
        warm_up(job, member)
        told = {"progress": lambda t: tell(choice.label, t / job.time), "out": path, "overwrite": overwrite}
        return solve(job.model, job.time, member, q0=job.q0, v0=job.v0, **told), path


def require_none(options, why):
    """Raise InputError for an option that was given."""
    if strange := [name for name, value in options.items() if value is not None]:
        raise InputError(f"run: --{strange[0].replace('_', '-')} has no place here: {why}")


def resumed(path, scene, cells, time):
    """Go on with the run in a file; the model comes from `scene` where that is given."""
    from polyida.run.resume import resume
    from polyida.study.comparison.job import load

    job = load(scene, time=time, cells=cells) if scene else None
    end = time or loaded(path).plan.get("t_end") or 1.0
    with bars() as tell, job.code() if job else nullcontext():
        return resume(path, time, model=job and job.model, progress=lambda t: tell("going on", t / end))


def loaded(file):
    """A saved run; InputError where there is none."""
    from polyida.io.load import load

    if not file.is_file():
        raise InputError(f"{file}: there is no such file")
    return load(file)
