"""What has a name: problems, integrators, studies, each with a line on what it is."""

import sys

from polyida import registry
from polyida.cli import scripts
from polyida.cli.screen import tables

LISTED = {"compared": "quantity", "source": "source"}


def problems() -> list[dict]:
    """{name, what, compared, source} of each; the last two are empty for a user's."""
    from polyida.problems.about import ABOUT

    return [
        {"name": name, "what": _description(registry.find(registry.problems, name))}
        | {told: ABOUT[name][key].split(";")[0] if name in ABOUT else "" for told, key in LISTED.items()}
        for name in registry.problems
    ]


def integrators() -> list[dict]:
    """{name, what} of each; those of one class stand once, by the shorter name."""
    from polyida.study.comparison.chosen import KNOWN

    short = {of_class: name for name, (of_class, *_) in KNOWN.items()}
    return [
        {"name": short.get(name, name), "what": _first_line(registry.find(registry.integrators, name))} for name in registry.integrators
    ]


def studies() -> list[dict]:
    """{name, what} of those that come with polyida and of those of the registry."""
    own = [{"name": name, "what": registry.find(registry.studies, name).title} for name in registry.studies]
    return [{"name": name, "what": scripts.title(path)} for name, path in scripts.scripts().items()] + own


def show(found: dict[str, list[dict]]) -> None:
    """Print a table of each kind."""
    for kind, things in found.items():
        rows = [[thing["name"], _in_lines(thing)] for thing in things]
        tables.texts([kind[:-1] if kind != "studies" else "study", "what it is"], rows)


def _in_lines(thing):
    more = [f"{key}: {thing[key]}" for key in LISTED if thing.get(key)]
    return "\n".join([thing["what"], *more, *[""] * bool(more)])


def _description(function):
    """First line of what a problem's function, or its module where that holds one problem, says of itself."""
    return _first_line(sys.modules[function.__module__] if getattr(function, "__name__", "") == "problem" else function)


def _first_line(described):
    return (described.__doc__ or "").strip().split("\n")[0]
