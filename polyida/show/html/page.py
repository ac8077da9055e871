"""The page itself: its frame, style and scripts, and the files beside it."""

from html import escape
from pathlib import Path

from polyida.errors import InputError
from polyida.machine import footer, machine_info
from polyida.show.html.blocks import Picture, prose
from polyida.show.press import drawn

HERE = Path(__file__).parent
BESIDE = ("png", "pdf", "csv")  # kinds of a picture's files that lie beside the page


def write(folder, title, blocks, command, machine=None, lead="", press=None):
    """Write report.html into a folder, with NAME.png, NAME.pdf and NAME.csv of each Picture; returns its path.

    command: what made it, and machine: where, by default here (`machine_info`); both stand at the page's end. lead: a paragraph below the
    title. press: a Press that has drawn some of the pictures, by their names. What is there under these names is replaced. Raises
    InputError for two pictures of one name.
    """
    folder, pictures = Path(folder), [block for block in blocks if isinstance(block, Picture)]
    names = [picture.name for picture in pictures]
    if twice := [name for name in names if names.count(name) > 1]:
        raise InputError(f"report: two pictures are called {twice[0]!r}; each needs a name of its own")
    folder.mkdir(parents=True, exist_ok=True)
    for picture in pictures:
        if press and picture.name not in press:
            press.give(picture.name, picture.figure)
    sheets = press.files() if press else {picture.name: drawn(picture.figure) for picture in pictures}
    for picture in pictures:
        for kind in BESIDE:
            (folder / f"{picture.name}.{kind}").write_bytes(sheets[picture.name][kind])
    path = folder / "report.html"
    path.write_text(page(title, blocks, command, machine or machine_info(), lead, sheets), encoding="utf-8")
    return path


def page(title, blocks, command, machine, lead, sheets):
    """The page as text. sheets: the files of its pictures, {name: {kind: bytes}}."""
    return PAGE.format(
        title=escape(title),
        style=_read("page.css"),
        lead=f'<p class="lead">{prose(lead)}</p>' if lead else "",
        blocks="\n".join(block.html(sheets) for block in blocks),
        command=escape(command),
        machine=escape(footer(machine)),
        script="\n".join(_read(name) for name in ("table.js", "movie.js")),
    )


def _read(name):
    return (HERE / name).read_text(encoding="utf-8")


PAGE = """<!doctype html>
<html lang="en">
<head>
<meta charset="utf-8">
<meta name="viewport" content="width=device-width, initial-scale=1">
<title>{title}</title>
<style>
{style}</style>
</head>
<body>
<a class="skip" href="#content">Skip to the content</a>
<header>
<h1>{title}</h1>
{lead}
</header>
<main id="content" tabindex="-1">
{blocks}
</main>
<footer>
<p>Made by <code>{command}</code></p>
<p>{machine}</p>
</footer>
<script>
{script}</script>
</body>
</html>
"""
