"""Tables of studies for papers in LaTeX: a `tabular` with the rules of booktabs, its numbers plain or aligned by siunitx."""

import re
from numbers import Real

from polyida.show.html import format_value, is_missing

SYMBOLS = {"q": "q", "v": "v", "a": "a", "lam": r"\lambda", "mu": r"\mu", "phi": r"\varphi", "x": "x", "J": "J", "h": "h"}
SPELLED = {"CPU s": "CPU time, s"}  # headings that are short for a terminal
SPECIAL = {"\\": r"\textbackslash{}", "~": r"\textasciitilde{}", "^": r"\textasciicircum{}", "λ": r"$\lambda$", "φ": r"$\varphi$"}
SPECIAL |= {letter: f"\\{letter}" for letter in "&%$#_{}"}
SYMBOL = re.compile(rf"(?<![\w(])({'|'.join(SYMBOLS)})(?![\w(\\])")
NUMBER = re.compile(r"(-?)(\d+)(?:\.(\d+))?(?:e([+-]?\d+))?")
PLAIN = r"-?\d+(?:\.\d+)?(?:e[+-]?\d+)?"  # a number without groups
VALUE = rf"{PLAIN}|\({PLAIN}(?:, {PLAIN})*\)|'[^']*'|\w+"
SETTING = re.compile(rf"(\w+) ?= ?({VALUE})")
SETTINGS = re.compile(rf"(?:(\w+)\()?(\w+ ?= ?(?:{VALUE})(?:, \w+ ?= ?(?:{VALUE}))*)(?(1)\))")  # with or without the name of the integrator
MISSING = "--"


def latex_table(columns, rows, siunitx):
    """The `tabular` of rows; columns: {name: (heading, format)}. siunitx: True for columns `S` of numbers."""
    kinds, cells = [], []
    for name, (heading, form) in columns.items():
        values = [row.get(name) for row in rows]
        numeric = _is_numeric(values)
        texts = [format_value(value, form, "") for value in values]
        aligned = numeric and siunitx and all(NUMBER.fullmatch(text) for text in texts if text)
        kinds.append(f"S[table-format={_format(texts)}]" if aligned else "r" if numeric else "l")
        shown = [_entry(text, numeric, aligned) for text in texts]
        head = latex_heading(heading)
        cells.append([f"{{{head}}}" if aligned else head, *shown])
    widths = [max(map(len, column)) for column in cells]
    lines = [" & ".join(text.ljust(width) for text, width in zip(line, widths)).rstrip() + r" \\" for line in zip(*cells)]
    needs = r"% \usepackage{booktabs, siunitx}" if siunitx else r"% \usepackage{booktabs}"
    begin = rf"\begin{{tabular}}{{{' '.join(kinds)}}}"
    return "\n".join([needs, begin, r"\toprule", lines[0], r"\midrule", *lines[1:], r"\bottomrule", r"\end{tabular}"]) + "\n"


def latex_heading(heading):
    """A heading with its symbols in mathematics: "error in lam, N" gives r"error in $\\lambda$, N"."""
    heading = latex_text(SPELLED.get(heading, heading))
    quantity, comma, unit = heading.partition(",")
    return SYMBOL.sub(lambda found: f"${SYMBOLS[found[1]]}$", quantity) + comma + unit


def latex_text(text):
    """A text with the special characters of LaTeX escaped, in one line."""
    return "".join(SPECIAL.get(letter, letter) for letter in " ".join(text.split()))


def latex_number(text):
    """A formatted number in mathematics: "2.3e-05" gives r"$2.3 \\cdot 10^{-5}$", "1e-05" "$10^{-5}$"."""
    found = NUMBER.fullmatch(text)
    if not found:
        return latex_text(text)
    sign, whole, decimals, power = found.groups()
    digits = f"{sign}{whole}.{decimals}" if decimals else f"{sign}{whole}"
    if power is None:
        return f"${digits}$"
    if digits in ("1", "-1"):
        return f"${sign}10^{{{int(power)}}}$"
    return rf"${digits} \cdot 10^{{{int(power)}}}$"


def _is_numeric(values):
    """True if a column of values has numbers, apart from missing values, and nothing else."""
    known = [value for value in values if not is_missing(value)]
    return bool(known) and all(isinstance(value, Real) and not isinstance(value, bool) for value in known)


def _entry(text, numeric, aligned):
    """A cell of the table in LaTeX; numeric: of a column of numbers, aligned: of a column `S` of siunitx."""
    if not text:
        return f"{{{MISSING}}}" if aligned else MISSING
    if aligned:
        return re.sub(r"e([+-])0*(\d)", lambda power: f"e{power[1].strip('+')}{power[2]}", text)
    return latex_number(text) if numeric else _text_entry(text)


def _text_entry(text):
    """A text; settings such as "h=1e-03", "IDA(rtol=1e-05, atol=(1e-07, 0.001))" with their numbers in mathematics."""
    found = SETTINGS.fullmatch(text)
    if not found:
        return latex_text(text)
    shown = ", ".join(_setting(name, value) for name, value in SETTING.findall(found[2]))
    return f"{latex_text(found[1])}({shown})" if found[1] else shown


def _setting(name, value):
    """One setting such as `rtol=1e-05` in mathematics; a word as its value stays text."""
    numbers = re.findall(PLAIN, value)
    if value[0] not in "-(0123456789":  # a word
        return latex_text(f"{name}={value}")
    shown = ", ".join(latex_number(number)[1:-1] for number in numbers)
    symbol = SYMBOLS.get(name, rf"\mathrm{{{latex_text(name)}}}")
    return f"${symbol} = {f'({shown})' if value[0] == '(' else shown}$"


def _format(texts):
    """The digits of numbers in siunitx's form: of 1.2e-05 and 31.25 "2.2e-2"."""
    parts = [NUMBER.fullmatch(text).groups(default="") for text in texts if text]
    sign = "-" if any(part[0] for part in parts) else ""
    whole = max((len(part[1]) for part in parts), default=1)
    decimals = max((len(part[2]) for part in parts), default=0)
    powers = [int(part[3]) for part in parts if part[3]]
    power = ""
    if powers:
        power = f"e{'-' if min(powers) < 0 else ''}{max(len(str(abs(one))) for one in powers)}"
    return f"{sign}{whole}{f'.{decimals}' if decimals else ''}{power}"
