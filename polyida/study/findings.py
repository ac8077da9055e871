"""What follows from a study's rows, part by part: a part that cannot be formed is told and spoils no other."""

import math
from dataclasses import dataclass, field
from itertools import chain


@dataclass
class Findings:
    """figures: {name: number}, NaN where it could not be formed; notes: lines; pictures: of the report."""

    figures: dict
    notes: list
    pictures: list = field(default_factory=list)


def findings(study, rows):
    """All of a study's findings, whatever rows failed: the `headline` figures are there in any case.

    figures, notes and draw of a study are a function of the rows each, or a tuple of such functions, each formed alone.
    """
    figures, unformed = {name: math.nan for name in study.headline}, []
    for found in _formed(study.figures, unformed, rows):
        figures |= {name: float(value) for name, value in found.items()}
    missing = [name for name, value in figures.items() if not math.isfinite(value)]
    lines = [line for found in _formed(study.notes, unformed, rows) for line in found]
    pictures = [path for found in _formed(study.draw, unformed, rows) for path in found]
    lines += [f"no value, no run that went well gives one: {', '.join(missing)}"] if missing else []
    return Findings(figures, lines + unformed + failures(study, rows), pictures)


def columns_of(study, rows):
    """The columns of a study's table."""
    return study.columns or tuple(name for name in dict.fromkeys(chain(*rows)) if name not in ("error", "traceback"))


def failures(study, rows):
    """A line for each failed task."""
    names = {name for task in study.tasks(False) + study.tasks(True) for name in task}
    failed = [(", ".join(f"{name} {row[name]}" for name in row if name in names), row["error"]) for row in rows if row.get("error")]
    return [f"failed: {name[:100]}: {error}" for name, error in failed]


def shortened(study):
    """A line on what the short selection of a study leaves out: the values that it does not have, name by name."""
    short, full = study.tasks(True), study.tasks(False)
    absent = [line for name in dict.fromkeys(chain(*full)) if (line := _absent(name, _values(short, name), _values(full, name)))]
    told = f"the short selection has {len(short)} runs, the full one {len(full)}; not in the short one: {'; '.join(absent)}"
    return [told] if absent else []


def _values(tasks, name):
    return dict.fromkeys(task[name] for task in tasks if isinstance(task.get(name), (str, int, float)) and not isinstance(task[name], bool))


def _absent(name, short, full, told=8):
    """The values of a name that the short selection does not have: names all of them, numbers where they are few."""
    found = [value if isinstance(value, str) else f"{value:g}" for value in full if value not in short]
    named = len(found) <= told or any(isinstance(value, str) for value in full)
    return f"{name} {', '.join(found) if named else f'of {len(found)} values'}" if found else ""


def _formed(parts, unformed, *arguments):
    """What each part gives; of one that raises, a line in `unformed`."""
    for part in parts if isinstance(parts, tuple) else (parts,):
        try:
            yield part(*arguments)
        except Exception as error:  # noqa: BLE001, rows may lack anything: what else they tell must come out all the same
            reason = str(error) if isinstance(error, LookupError) and " " in str(error) else f"{type(error).__name__}: {error}"
            unformed.append(f"not formed: {part.__name__.strip('_')}: {reason}")
