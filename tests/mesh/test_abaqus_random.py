"""Random Abaqus decks against coordinates computed beside them: instances, sets of all kinds, continued and commented lines."""

import numpy as np
import pytest

from polyida.mesh import read

KINDS = {
    3: ["CPS3", "CPE3", "S3", "S3R", "CPE3H"],
    4: ["CPS4", "CPS4R", "CPE4R", "S4R", "M3D4", "CPS4I"],
    6: ["CPS6M", "STRI65"],
    8: ["CPS8R", "S8R"],
}


class Deck:
    """Lines of a deck, and the places of nodes and sets that it must give."""

    def __init__(self, rng):
        self.rng, self.lines, self.parts, self.placed, self.sets = rng, ["*Heading", "a plate"], {}, {}, {}

    def keyword(self, name, *options, rows=()):
        rng = self.rng
        case = [str.upper, str.lower, str.title][rng.integers(3)]
        cut = int(rng.integers(1, len(options))) if len(options) > 1 and rng.random() < 0.3 else len(options)
        first, rest = ", ".join([case(name), *options[:cut]]), ", ".join(options[cut:])
        self.lines += [f"*{first}" + ("," if rest else ""), *([rest] if rest else [])]
        for row in rows:
            if rng.random() < 0.1:
                self.lines.append("** a comment, 1, 2, 3")
            self.lines.append((" " * int(rng.integers(3))) + ", ".join(row) + ("," if rng.random() < 0.1 else ""))

    def number(self, value):
        text = repr(float(value))
        return text.replace("e", "D") if "e" in text and self.rng.random() < 0.5 else text

    def part(self, name):
        """A grid of cells of one type, nodes and elements with numbers by chance."""
        rng = self.rng
        nx, ny, corners = (int(n) for n in (rng.integers(1, 4), rng.integers(1, 4), rng.choice([3, 4, 6, 8])))
        x, y = np.meshgrid(np.arange(nx + 1.0), np.arange(ny + 1.0))
        points = np.column_stack([x.ravel(), y.ravel()]) * rng.uniform(0.1, 2.0, 2)
        cells = [
            [j * (nx + 1) + i, j * (nx + 1) + i + 1, (j + 1) * (nx + 1) + i + 1, (j + 1) * (nx + 1) + i]
            for j in range(ny)
            for i in range(nx)
        ]
        cells = cells if corners in (4, 8) else [half for a, b, c, d in cells for half in ((a, b, c), (a, c, d))]
        middles = corners in (6, 8)
        nodes = {}
        if middles:
            cells = [
                (*cell, *[nodes.setdefault(tuple(sorted(edge)), len(points) + len(nodes)) for edge in zip(cell, (*cell[1:], cell[0]))])
                for cell in cells
            ]
            points = np.concatenate([points, [points[list(edge)].mean(axis=0) for edge in nodes]])
        corner = sorted({node for cell in cells for node in cell[: 3 if corners in (3, 6) else 4]})
        labels = rng.choice(np.arange(1, 500), len(points), replace=False).tolist()
        numbers = rng.choice(np.arange(1, 500), len(cells), replace=False).tolist()
        self.keyword("Part", f"name={name}")
        self.keyword("Node", rows=[(str(labels[n]), *map(self.number, points[n])) for n in rng.permutation(len(points))])
        rows = []
        for number, cell in zip(numbers, cells):
            entries = [str(number), *(str(labels[node]) for node in cell)]
            cut = int(rng.integers(2, len(entries))) if rng.random() < 0.3 else len(entries)
            rows += [entries[:cut]] + ([entries[cut:]] if cut < len(entries) else [])
        self.keyword("Element", f"type={rng.choice(KINDS[corners])}", "elset=All", rows=[] if middles else rows)
        if middles:  # continued lines end with a comma
            self.lines += [
                ", ".join([str(number), *(str(labels[node]) for node in cell[:4])])
                + ",\n"
                + ", ".join(str(labels[node]) for node in cell[4:])
                for number, cell in zip(numbers, cells)
            ]
        some = sorted(rng.choice(corner, int(rng.integers(1, len(corner) + 1)), replace=False).tolist())
        self.keyword("Nset", "nset=Some", rows=[[str(labels[node])] for node in some[::2]])
        self.keyword("Nset", 'nset="some"', "unsorted", rows=[[str(labels[node])] for node in some[1::2]])
        self.keyword("Elset", "elset=First", rows=[[str(numbers[0])]])
        self.keyword("Nset", "nset=OfFirst", "elset=First")
        by_label = dict(zip(labels, range(len(points))))
        low, step = int(rng.integers(1, 20)), int(rng.integers(1, 9))
        within = [label for label in range(low, 500, step) if by_label.get(label) in corner]
        run = within[:1]
        if run:
            self.keyword("Nset", "nset=Run", "generate", rows=[(str(run[0]), str(run[0]), str(step))])
        self.keyword("End Part")
        first = sorted(set(cells[0]) & set(corner))
        sets = {"Some": some, "OfFirst": first} | ({"Run": [by_label[run[0]]]} if run else {})
        self.parts[name] = {"points": points, "corner": corner, "labels": labels, "numbers": numbers, "cells": cells, "sets": sets}

    def instance(self, name, part, shift):
        rng = self.rng
        self.keyword("Instance", f"name={name}", f"part={part}")
        move, centre, angle = shift + rng.uniform(-1, 1, 2), rng.uniform(-1, 1, 2), float(rng.uniform(-180, 180))
        kind = int(rng.integers(1 if self.placed else 0, 3))
        points = self.parts[part]["points"]
        if kind > 0:
            self.lines.append(", ".join(map(self.number, [*move, 0.0])))
            points = points + move
        if kind > 1:
            up = float(rng.choice([1.0, -1.0]))
            self.lines.append(", ".join(map(self.number, [*centre, 0.0, *centre, up, angle])))
            c, s = np.cos(np.radians(up * angle)), np.sin(np.radians(up * angle))
            points = (points - centre) @ [[c, s], [-s, c]] + centre
        self.keyword("End Instance")
        self.placed[name] = (part, points)

    def across(self):
        """Sets of the assembly: of numbers, sets, elements and element sets of an instance, of other sets."""
        for index, (name, (part, points)) in enumerate(self.placed.items()):
            data = self.parts[part]
            node = data["corner"][0]
            self.keyword("Nset", f"nset=N{index}", f"instance={name}", rows=[[str(data["labels"][node])]])
            self.keyword("Nset", f"nset=M{index}", rows=[[f"{name}.Some"], [f"N{index}"]])
            self.keyword("Elset", f"elset=E{index}", f"instance={name}", rows=[[str(data["numbers"][-1])]])
            self.keyword("Nset", f"nset=L{index}", f"elset=E{index}")
            last = sorted(set(data["cells"][-1]) & set(data["corner"]))
            self.sets |= {
                f"N{index}": points[[node]],
                f"M{index}": points[sorted({node, *data["sets"]["Some"]})],
                f"L{index}": points[last],
            }


def random_deck(seed):
    deck = Deck(np.random.default_rng(seed))
    names = ["Plate", "Arm"][: int(deck.rng.integers(1, 3))]
    for name in names:
        deck.part(name)
    deck.keyword("Assembly", "name=All")
    turned = 0
    for name in names:
        for copy in range(int(deck.rng.integers(1, 3))):
            deck.instance(f"{name}-{copy + 1}", name, np.array([60.0 * turned, 0.0]) if copy or turned else np.zeros(2))
            turned += 1
    deck.across()
    deck.keyword("End Assembly")
    return deck


def apart(deck):
    """True if no two instances overlap."""
    boxes = [(points.min(axis=0), points.max(axis=0)) for _, points in deck.placed.values()]
    return all((a[0] > b[1]).any() or (b[0] > a[1]).any() for i, a in enumerate(boxes) for b in boxes[:i])


def ordered(points):
    return np.array(sorted(np.round(points, 9).tolist()))


@pytest.mark.filterwarnings("ignore::polyida.mesh.MeshWarning")
@pytest.mark.parametrize("seed", range(12))
def test_random_decks_have_their_nodes_and_sets_in_place(tmp_path, seed):
    decks = (random_deck([seed, attempt]) for attempt in range(100))
    deck = next(deck for deck in decks if apart(deck))
    path = tmp_path / "deck.inp"
    path.write_text("\n".join(deck.lines) + "\n")
    mesh = read(path)
    corners = np.concatenate([points[deck.parts[part]["corner"]] for part, points in deck.placed.values()])
    assert ordered(mesh.linear.points) == pytest.approx(ordered(corners), abs=2e-9)
    if mesh.order == 2:
        every = np.concatenate([points for _, points in deck.placed.values()])
        assert ordered(mesh.points) == pytest.approx(ordered(every), abs=2e-9)
    for name, (part, points) in deck.placed.items():
        for called, nodes in deck.parts[part]["sets"].items():
            deck.sets[called if len(deck.placed) == 1 else f"{name}.{called}"] = points[nodes]
    for name, points in deck.sets.items():
        found = mesh.sections[name]  # and the middle nodes of whole sides
        assert ordered(mesh.points[found[~mesh.middle_nodes[found]]]) == pytest.approx(ordered(points), abs=2e-9), name
