"""The picture at the top of the README: `python studies/guide/front_picture.py` measures and draws it, in about a minute on one core."""

import re
from pathlib import Path

import polyida as pi
from polyida.show.styles import INK, PALETTE, figure, rendered, settings

PLACE = Path(__file__).with_name("integrators.svg")
MEMBERS = {
    "generalized-alpha": [pi.GeneralizedAlpha(h=h) for h in (4e-3, 2e-3, 1e-3, 5e-4, 2.5e-4, 1.25e-4)],
    "energy-momentum": [pi.EnergyMomentum(h=h) for h in (2e-3, 1e-3, 5e-4, 2.5e-4)],
    "IDA": [pi.IDA(rtol=rtol) for rtol in (1e-4, 1e-5, 1e-6, 1e-7)],
    "Radau IIA": [pi.RadauIIA(rtol=rtol) for rtol in (1e-4, 1e-5, 1e-6, 1e-7, 1e-8, 1e-9)],
}
MARKS = ("o", "s", "^", "D")
ROUNDS = 3  # of each run, of which the quickest counts
DARK = {"#ffffff": ("paper", "#15181c"), "#222222": ("ink", "#e8eaed"), "#dddddd": ("grid", "#3a4048")}


def measured(problem, integrator):
    """(CPU seconds, tip error in m, steps) of a run; kernels are loaded by the first round."""
    runs = [pi.solve(problem.model, problem.t_end, integrator) for _ in range(ROUNDS)]
    return min(run.cpu_seconds for run in runs), problem.compare(runs[0])["tip"], runs[0].steps


def drawn(points, problem):
    """The figure of {label: [(CPU seconds, error, steps)]}."""
    with settings():
        made, axes = figure(6.4, 3.7)
        for (label, found), colour, mark in zip(points.items(), PALETTE, MARKS):
            cpu, error, _ = zip(*found)
            axes.loglog(cpu, error, color=colour, marker=mark, markersize=4.5, label=label)
        axes.set(xlabel="CPU time of the run, s (one core)", ylabel="error of the tip after 1 s, m")
        axes.set_title(f"Two swinging plates, {problem.model.n} coordinates: CPU time against error", color=INK)
        axes.legend(loc="upper right", labelcolor=INK)
        return made


def light_and_dark(svg):
    """The SVG with its paper, ink and grid as the viewer's colour scheme has them."""
    names = "; ".join(f"--{name}: {dark}" for name, dark in DARK.values())
    style = f"<style>@media (prefers-color-scheme: dark) {{ svg {{ {names} }} }}</style>"

    def coloured(found):
        kind, colour = found.groups()
        return f"{found[0]}; {kind}: var(--{DARK[colour][0]}, {colour})" if colour in DARK else found[0]

    svg = re.sub(r"\b(fill|stroke): (#[0-9a-f]{6})\b", coloured, svg).replace("'DejaVu Sans'", "'DejaVu Sans', Verdana, sans-serif")
    return re.sub(r"(<svg[^>]*>)", rf"\1\n {style}", svg, count=1)


def main():
    problem = pi.problems.get("double-plate")
    points = {label: [measured(problem, member) for member in members] for label, members in MEMBERS.items()}
    PLACE.write_text(light_and_dark(rendered(drawn(points, problem), "svg").decode()), encoding="utf-8")
    for label, found in points.items():
        for member, (cpu, error, steps) in zip(MEMBERS[label], found):
            print(f"{label:18}{getattr(member, 'h', None) or member.rtol:9.3g} {steps:6} steps {cpu:7.3f} CPU s  tip off by {error:.1e} m")


if __name__ == "__main__":
    main()
