"""From the formulas of joints to the arrays that the row kernels read: rows of phi, the points that they hold on to, and profiles."""

from traceback import extract_tb

import numpy as np

from polyida.assembly.arrays import concatenated, starts
from polyida.errors import InputError
from polyida.joint.attachment import Ground
from polyida.joint.formula import in_words, rows_of
from polyida.joint.joint import Joint

ROUND = 1e-12  # of the scene's size: what the round-off of a formula leaves at rest
CLOSED = 1e-6  # of the scene's size: sides that are apart by less at rest are taken to meet


class RowTable:
    """Collects rows of phi; `labels` says what to call each, `rows` which rows are whose, `joints` holds the joints.

    points, drives: where attachments and profiles get their numbers. size: of the scene, m. left_out: numbers of rows, of all that are
    given, that it has not.
    """

    def __init__(self, points, drives, size, left_out=()):
        self._points, self._drives, self._size, self._left_out, self._given = points, drives, size, frozenset(left_out), 0
        self._products, self._vectors, self._constants, self._slopes, self._shifts = [], [], [], [], []
        self.labels, self.units, self.rows, self.joints = [], [], {}, {}

    def add(self, name, part):
        """Append the rows of a joint or body. Raises InputError where they are no rows, or do not hold at rest."""
        first, rows = len(self.labels), given_rows(name, part)
        for row, label in zip(rows, _called(name, [row.label for row in rows])):
            self._given += 1
            if self._given - 1 in self._left_out:
                continue
            if not row.driven and abs(_at_rest(row)) > CLOSED * self._size:
                raise InputError(f"{name}: it does not hold at rest, phi = {_at_rest(row):.3g}; {_apart(part)}")
            self._row(name, row)
            self.labels.append(label)
            self.units.append(row.unit)
        self.rows[name], self.joints[name] = slice(first, len(self.labels)), part

    def _row(self, name, row):
        """Append a row; one that only moves the vectors' rest by round-off of the places starts at exactly zero."""
        small = abs(_at_rest(row)) <= ROUND * self._size
        linear = [product for product in row.products if product.linear]
        slopes = {}
        for product in linear:
            for one, other in ((product.turning, product.still), (product.still, product.turning)):
                for point, w in self._weights(one).items():
                    slopes[point] = slopes.get(point, 0j) + w.conjugate() * other.constant
        number = len(self._constants)
        self._constants.append(row.constant + sum(map(_value_at_rest, linear)) - (_at_rest(row) if small or not row.driven else 0.0))
        self._slopes.append(slopes)
        self._shifts += [(number, self._drives.add(profile, name), factor) for factor, profile in row.drives]
        for product in row.products:
            if not product.linear:
                profile = product.turning.profile
                drive = -1 if profile is None else self._drives.add(profile, name)
                self._products.append((number, self._vector(product.turning), self._vector(product.still), drive, product.one_way))

    def _vector(self, piece):
        """Number of a vector: its value at rest, and the weight of each point."""
        self._vectors.append((piece.rest, self._weights(piece)))
        return len(self._vectors) - 1

    def _weights(self, piece):
        weights = {}
        for side, part, w in piece.terms:
            point = self._points.add(side, part)
            weights[point] = weights.get(point, 0j) + w
        return weights

    def arrays(self):
        """The fields of Links that describe the rows."""
        row, first, second, drive, one_way = zip(*self._products) if self._products else [()] * 5
        shifted, shift, factor = zip(*self._shifts) if self._shifts else [()] * 3
        rest = np.array([value for value, _ in self._vectors], complex)
        points = [list(weights) for _, weights in self._vectors]
        weights = np.array([w for _, weights in self._vectors for w in weights.values()], complex)
        touched = [dict.fromkeys(slopes) for slopes in self._slopes]  # the points of each row, in the order of its formula
        for number, one, other, *_ in self._products:
            touched[number] |= dict.fromkeys([*self._vectors[one][1], *self._vectors[other][1]])
        columns = [[2 * point + axis for point in row for axis in range(2)] for row in touched]
        slopes = np.array([row.get(point, 0j) for row, points in zip(self._slopes, touched) for point in points], complex)
        return {
            "row_constant": np.array(self._constants, float),
            "row_start": starts(columns),
            "row_columns": np.array([c for row in columns for c in row], np.int64),
            "row_slopes": _pairs(slopes).ravel(),
            "shift_row": np.array(shifted, np.int64),
            "shift_drive": np.array(shift, np.int64),
            "shift_factor": np.array(factor, float),
            "product_row": np.array(row, np.int64),
            "product_first": np.array(first, np.int64),
            "product_second": np.array(second, np.int64),
            "product_drive": np.array(drive, np.int64),
            "product_one_way": np.array(one_way, np.bool_),
            "vector_rest": _pairs(rest),
            "vector_start": starts(points),
            "vector_points": np.array([p for row in points for p in row], np.int64),
            "vector_weights": _pairs(weights),
        }


class Points:
    """Collects weighted sums of pairs of q; equal sums are one point. places: {id of a body: its place in the scene}."""

    def __init__(self, places):
        self._places, self._index = places, {}
        self.nodes, self.weights, self.mass = [], [], []

    def add(self, attachment, part="point"):
        """Number of the point ("point") or direction ("direction") of an attachment."""
        if id(attachment.body) not in self._places:
            raise InputError(f"a row of phi is made of {attachment.body.label}, which is not in the scene; add it with scene.add")
        pairs, weights = self._places[id(attachment.body)].held(attachment, part)
        key = (pairs.tobytes(), weights.tobytes())
        if key not in self._index:
            self._index[key] = len(self.nodes)
            self.nodes.append(pairs)
            self.weights.append(weights)
            self.mass.append(0.0)
        return self._index[key]

    def arrays(self):
        """The fields of Links that describe the points."""
        weights = concatenated(self.weights, complex)
        return {
            "point_ptr": starts(self.nodes),
            "point_nodes": concatenated(self.nodes, np.int32),
            "point_weights": np.stack([weights.real, weights.imag], axis=1),
            "point_mass": np.array(self.mass, float),
        }


class Drives:
    """The profiles of a scene, each once."""

    def __init__(self):
        self.profiles, self.names = [], []

    def add(self, profile, name):
        """Number of the profile, which a part of that name has."""
        for number, known in enumerate(self.profiles):
            if known is profile:
                return number
        self.profiles.append(profile)
        self.names.append(name)
        return len(self.profiles) - 1


def given_rows(name, part):
    """The Rows of a part, a list, empty of a body alone. Raises InputError, naming part and entry, for anything else."""
    what = f"{name}: rows() of {type(part).__name__}"
    try:
        rows = part.rows()
        if not isinstance(rows, (list, tuple)):
            raise InputError(f"it must give a list of rows, not {in_words(rows)}")
        found = list(rows_of(rows))
    except InputError as error:
        raise error if repr(name) in str(error) else InputError(f"{what}{_line(error)}: {error}") from error
    except Exception as error:
        raise InputError(f"{what} raised {type(error).__name__}{_line(error)}: {error}") from error
    if not found and isinstance(part, Joint):
        raise InputError(f"{what}: it must give a list of rows, at least one")
    for number, row in enumerate(found, 1):
        if not np.isfinite(_at_rest(row)):
            raise InputError(f"{what}: row {number} of {len(found)} is not finite at rest")
    return found


def _line(error):
    """The line of rows() that raised an error, for messages."""
    lines = [frame.line for frame in extract_tb(error.__traceback__) if frame.name == "rows" and frame.line]
    return f", in `{lines[-1]}`" if lines else ""


def _apart(part):
    """What to do about a part whose rows do not hold at rest."""
    if not isinstance(part, Joint):
        return "its coordinates() must be on the rows that it gives"
    a, b = part.a, part.b
    apart = np.linalg.norm(a.point - b.point)
    sides = " and ".join(repr(side) if isinstance(side, Ground) else f"{side!r} at {_place(side)}" for side in (a, b))
    return f"its sides are {sides}, {apart:.3g} m apart; {part.placing}, or let scene.assemble() move them"


def _called(name, labels):
    """Labels of a joint's rows: as they are named, or by number where they are not and there are several."""
    many = len(labels) > 1
    return [f"{name} {label or (number if many else '')}".rstrip() for number, label in enumerate(labels)]


def _at_rest(row):
    return row.constant + sum(map(_value_at_rest, row.products))


def _value_at_rest(product):
    return (product.turning.rest.conjugate() * product.still.rest).real


def _pairs(numbers):
    return np.ascontiguousarray(np.stack([numbers.real, numbers.imag], axis=-1).reshape(-1, 2))


def _place(attachment):
    x, y = (round(float(value), 12) + 0.0 for value in attachment.point)  # without round-off of zero, which differs from machine to machine
    return f"({x:.6g}, {y:.6g})"
