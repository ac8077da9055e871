"""The rows of phi of a scene, from the formulas of its joints and bodies: each is a constant, slopes of points and products of vectors.

`RowTable.add` takes a joint's rows apart; `Points` numbers the places and directions in them, `Drives` the profiles. Out go the fields of `Links`
(arrays.py) that describe the rows.
"""

from traceback import extract_tb

import numpy as np

from polyida.assembly.arrays import starts
from polyida.errors import InputError
from polyida.joint.attachment import Ground
from polyida.joint.contact import Contact
from polyida.joint.edges import EdgeRows
from polyida.joint.formula import advice_on, in_words, with_laws
from polyida.joint.joint import Joint
from polyida.model.row_laws import RowLaw
from polyida.validation import pairs_of

ROUND = 1e-12  # of the scene's size: round-off of a formula at rest
CLOSED = 1e-6  # of the scene's size: largest gap at rest between sides that meet


class RowTable:
    """Collects the rows of phi and the velocity rows. labels, units: of each row; rows: {name: slice of its rows}; joints: {name: joint or body}.

    points, drives: number the attachments and the profiles. size: of the scene, m. left_out: numbers, among all rows, of rows to omit.
    laws: a RowLaw of each row with a law. edges: EdgeRows.
    """

    def __init__(self, points, drives, size, left_out=()):
        """Begin without rows; left_out: numbers of the rows that `add` omits."""
        self._points, self._drives, self._size, self._left_out, self._count = points, drives, size, frozenset(left_out), 0
        self._products, self._vectors, self._constants, self._slopes, self._shifts = [], [], [], [], []
        self.labels, self.units, self.rows, self.joints, self._velocity_rows, self.laws, self.edges = [], [], {}, {}, [], [], []

    def add(self, name, part, held=False):
        """Append the rows of a joint or body. Raises InputError if they are no rows, or do not hold in the reference configuration and need to (held: False)."""
        first, rows = len(self.labels), given_rows(name, part)
        if isinstance(part, Joint):
            rows = rows + given_rows(name, part, "velocity_rows")
            if not rows:
                raise InputError(f"{name}: rows() of {type(part).__name__}: it must give a list of rows, at least one, or velocity_rows()")
        numbers, edges = {}, None
        if isinstance(part, Contact) and part.edges and self._count not in self._left_out:
            edges = EdgeRows(first, part, self._points, self._size)
            self.edges.append(edges)
        for number, row in enumerate(rows):
            self._count += 1
            if self._count - 1 in self._left_out:
                continue
            at_rest = _at_rest(row)
            if row.gap and not held and at_rest < -CLOSED * self._size:
                raise InputError(f"{name}: its sides are {-at_rest:.3g} m within each other at rest; {_how_to_close(part, apart=False)}")
            if not (row.rate or row.driven or row.gap or held) and abs(at_rest) > CLOSED * self._size:
                raise InputError(f"{name}: it does not hold at rest, phi = {at_rest:.3g}; {_how_to_close(part)}")
            if edges:
                self._append_any(row, edges.numbers)
            else:
                self._append(name, row, held)
            numbers[number] = len(self.labels)
            if row.law:
                on = tuple(numbers[k] for k in row.law.on if k in numbers)
                self.laws.append(RowLaw(numbers[number], name, row.law.restitution, row.law.mu, row.law.constant, on))
            self.labels.append(f"{name} {row.label or (number if len(rows) > 1 else '')}".rstrip())
            self.units.append(row.unit)
        self.rows[name], self.joints[name] = slice(first, len(self.labels)), part

    def _append(self, name, row, held):
        """Append a row. Round-off in the reference configuration is subtracted, so that phi starts at exactly zero, unless it begins elsewhere (held: True)."""
        round_off = abs(_at_rest(row)) <= ROUND * self._size
        linear = [product for product in row.products if product.linear]
        slopes = {}
        for product in linear:
            for one, other in ((product.rotated, product.unrotated), (product.unrotated, product.rotated)):
                for point, w in self._weights(one).items():
                    slopes[point] = slopes.get(point, 0j) + w.conjugate() * other.constant
        number = len(self._constants)
        if row.rate:
            self._velocity_rows.append(number)
            self._constants.append(row.constant)
        else:
            at_rest = _at_rest(row) if (round_off or not (row.driven or row.gap)) and not held else 0.0
            self._constants.append(row.constant + sum(map(_value_at_rest, linear)) - at_rest)
        self._slopes.append(slopes)
        self._shifts += [(number, self._drives.add(profile, name), factor, 0 if row.rate else 1) for factor, profile in row.drives]
        for product in row.products:
            if not product.linear:
                profile, vectors = product.rotated.profile, []
                drive = -1 if profile is None else self._drives.add(profile, name)
                for piece in (product.rotated, product.unrotated):
                    vectors.append(len(self._vectors))
                    self._vectors.append((piece.rest, self._weights(piece)))
                self._products.append((number, *vectors, drive, product.one_way, product.unrotated.rate))

    def _append_any(self, row, points):
        """Append a row without products that may depend on these points."""
        if row.rate:
            self._velocity_rows.append(len(self._constants))
        self._constants.append(row.constant)
        self._slopes.append(dict.fromkeys(points.tolist(), 0j))

    def _weights(self, piece):
        """{point: weight} of a piece of a formula."""
        weights = {}
        for side, part, w in piece.terms:
            point = self._points.add(side, part)
            weights[point] = weights.get(point, 0j) + w
        return weights

    def arrays(self):
        """The fields of Links that describe the rows."""
        row, first, second, drive, one_way, rate = zip(*self._products) if self._products else [()] * 6
        shifted, shift, factor, order = zip(*self._shifts) if self._shifts else [()] * 4
        points = [list(weights) for _, weights in self._vectors]
        touched = [dict.fromkeys(slopes) for slopes in self._slopes]  # the points of each row, in the order of its formula
        for number, one, other, *_ in self._products:
            touched[number] |= dict.fromkeys([*self._vectors[one][1], *self._vectors[other][1]])
        columns = [[2 * point + axis for point in row for axis in range(2)] for row in touched]
        slopes = np.array([row.get(point, 0j) for row, points in zip(self._slopes, touched) for point in points], complex)
        return {
            "row_constant": np.array(self._constants, float),
            "row_start": starts(columns),
            "row_columns": np.array([c for row in columns for c in row], np.int64),
            "row_slopes": pairs_of(slopes).ravel(),
            "shift_row": np.array(shifted, np.int64),
            "shift_drive": np.array(shift, np.int64),
            "shift_factor": np.array(factor, float),
            "shift_order": np.array(order, np.int64),
            "product_row": np.array(row, np.int64),
            "product_first": np.array(first, np.int64),
            "product_second": np.array(second, np.int64),
            "product_drive": np.array(drive, np.int64),
            "product_one_way": np.array(one_way, np.bool_),
            "product_rate": np.array(rate, np.bool_),
            "velocity_rows": np.array(self._velocity_rows, np.int64),
            "vector_rest": pairs_of(np.array([value for value, _ in self._vectors], complex)),
            "vector_start": starts(points),
            "vector_points": np.array([p for row in points for p in row], np.int64),
            "vector_weights": pairs_of(np.array([w for _, weights in self._vectors for w in weights.values()], complex)),
        }


class Points:
    """Collects weighted sums of pairs of q; equal sums are one point. places: {id of a body: PlacedPlate or PlacedBody}."""

    def __init__(self, places):
        """Begin without points; places: {id of a body: where its coordinates are in q}."""
        self._places, self._numbers = places, {}
        self.nodes, self.weights, self.mass, self.turns = [], [], [], []

    def add(self, attachment, part="point"):
        """Number of the point ("point") or direction ("direction") of an attachment."""
        if id(attachment.body) not in self._places:
            raise InputError(f"a row of phi is made of {attachment.body.label}, which is not in the scene; add it with scene.add")
        pairs, weights = self._places[id(attachment.body)].pairs_and_weights(attachment, part)
        key = (pairs.tobytes(), weights.tobytes())
        if key not in self._numbers:
            self._numbers[key] = len(self.nodes)
            self.nodes.append(pairs)
            self.weights.append(weights)
            self.mass.append(0.0)
            self.turns.append(part == "direction")
        return self._numbers[key]


class Drives:
    """Collects the profiles of a scene, each once. names: of the part that added a profile first."""

    def __init__(self):
        """Begin without profiles and without names of parts."""
        self.profiles, self.names = [], []

    def add(self, profile, name):
        """Number of the profile of a part."""
        for number, known in enumerate(self.profiles):
            if known is profile:
                return number
        self.profiles.append(profile)
        self.names.append(name)
        return len(self.profiles) - 1


def given_rows(name, part, function="rows"):
    """The list of Rows that a function of a joint or body returns. Raises InputError, naming part and entry, for anything else.

    Rows of friction are velocity rows, and their laws have the numbers, in the list, of the rows that press.
    """
    what = f"{name}: {function}() of {type(part).__name__}"
    try:
        rows = getattr(part, function)()
        if not isinstance(rows, (list, tuple)):
            raise InputError(f"it must give a list of rows, not {in_words(rows)}")
        rows = with_laws(rows)
    except InputError as error:
        raise error if repr(name) in str(error) else InputError(f"{what}{_line(error)}: {error}") from error
    except Exception as error:
        raise InputError(f"{what} raised {type(error).__name__}{_line(error)}: {error}{advice_on(error)}") from error
    for number, row in enumerate(rows, 1):
        if row.rate is not (function == "velocity_rows") and not (row.law and row.rate):
            wanted = {
                "rows": "only velocity_rows() have .rate",
                "velocity_rows": "each product of a velocity row has one factor with .rate",
            }
            raise InputError(f"{what}: row {number} of {len(rows)}: {wanted[function]}")
        if not np.isfinite(_at_rest(row)):
            raise InputError(f"{what}: row {number} of {len(rows)} is not finite at rest")
    return rows


def _line(error):
    """The line of rows() that raised an error, for messages."""
    lines = [frame.line for frame in extract_tb(error.__traceback__) if frame.name in ("rows", "velocity_rows") and frame.line]
    return f", in `{lines[-1]}`" if lines else ""


def _how_to_close(part, apart=True):
    """Advice about a part whose rows do not hold in the reference configuration; apart: True if the distance of its places says by how much."""
    if not isinstance(part, Joint):
        return "its coordinates() must be on the rows that it gives"
    sides = []
    for side in (part.a, part.b):
        x, y = (round(float(value), 12) + 0.0 for value in side.point)  # without round-off of zero, which differs between machines
        sides.append(repr(side) if isinstance(side, Ground) else f"{side!r} at ({x:.6g}, {y:.6g})")
    distance = f", {np.linalg.norm(part.a.point - part.b.point):.3g} m apart" if apart else ""
    return f"its sides are {' and '.join(sides)}{distance}; {part.placing}, or let scene.assemble() move them"


def _at_rest(row):
    """The value of a row of phi in the reference configuration, without slopes of points and profiles."""
    return row.constant + sum(map(_value_at_rest, row.products))


def _value_at_rest(product):
    """The scalar product of the two vectors of a product in the reference configuration."""
    return (product.rotated.rest.conjugate() * product.unrotated.rest).real
