"""Instructions for compiled code that numba does not have: short vectors, addresses, calls by address, numbers shared by threads.

The kernels of elements process LANES cells with the same number of vertices side by side. With an explicit vector type the machine code does
not depend on an auto-vectoriser, and stays portable: LLVM splits vectors to fit the machine. Formulas of vectors are plain Python functions
decorated by `traced`: they run once, on stand-ins that emit the instructions. numba infers no types in them, so kernels compile fast, and the
same functions work on numpy arrays. Vectors of 2 COLUMNS float32 hold two rows of COLUMNS right-hand sides (linear/columns.py). Accesses are not
checked for bounds. Only the public numba.extending and llvmlite.ir are used.
"""

import sys
from inspect import signature

from llvmlite import ir
from numba import types
from numba.extending import intrinsic, lower_builtin, models, register_model, type_callable

LANES = 8
COLUMNS = 4  # right-hand sides that are solved for together
ARGUMENTS = 8  # of each C function that `call` calls

INT32, INT64, SINGLE, DOUBLE = ir.IntType(32), ir.IntType(64), ir.FloatType(), ir.DoubleType()


class Vector(types.Type):
    """`count` numbers of an LLVM type held in registers."""

    def __init__(self, count, number=DOUBLE):
        """Make the numba type of vectors of `count` numbers of an LLVM type."""
        super().__init__(name=f"Vector{count}{number}")
        self.element = ir.VectorType(number, count)


@register_model(Vector)
class VectorModel(models.PrimitiveModel):
    """A Vector is an LLVM vector."""

    def __init__(self, dmm, fe_type):
        """Take numba's data model manager and the Vector type, whose LLVM type is the value's."""
        super().__init__(dmm, fe_type, fe_type.element)


lanes, pair, columns = Vector(LANES), Vector(2), Vector(2 * COLUMNS, SINGLE)


class Traced:
    """Stand-in for a vector or a number; its arithmetic emits instructions."""

    def __init__(self, builder, value):
        """Take the LLVM builder that collects instructions, and the LLVM value."""
        self.builder, self.value = builder, value

    def _both(self, other):
        """The LLVM values of self and other; a number beside a vector is repeated in its lanes."""
        values = [self.value, other.value if isinstance(other, Traced) else ir.Constant(DOUBLE, float(other))]
        for vector in (value.type for value in values if isinstance(value.type, ir.VectorType)):
            return [_spread(self.builder, value, vector) for value in values]
        return values

    def _emit(self, instruction, operands):
        """The Traced result of an LLVM instruction such as "fadd"; products and sums may be contracted to fused multiply-adds."""
        return Traced(self.builder, getattr(self.builder, instruction)(*operands, flags=("contract",)))

    def __add__(self, other):
        """The sum, element by element; emits `fadd`."""
        return self._emit("fadd", self._both(other))

    def __sub__(self, other):
        """The difference self - other, element by element; emits `fsub`."""
        return self._emit("fsub", self._both(other))

    def __mul__(self, other):
        """The product, element by element; emits `fmul`."""
        return self._emit("fmul", self._both(other))

    def __truediv__(self, other):
        """The quotient self / other, element by element; emits `fdiv`."""
        return self._emit("fdiv", self._both(other))

    def __rsub__(self, other):
        """The difference other - self of a number and this; emits `fsub`."""
        return self._emit("fsub", self._both(other)[::-1])

    __radd__, __rmul__ = __add__, __mul__

    def shuffled(self, other, pattern):
        """The Traced vector of the lanes that `pattern` names, counted through self and then other."""
        return Traced(self.builder, _shuffle(self.builder, self.value, other.value, pattern))

    def least(self, other):
        """The smaller of the two in each lane; self if one is NaN."""
        less = self.builder.fcmp_ordered("<", other.value, self.value)
        return Traced(self.builder, self.builder.select(less, other.value, self.value))


def traced(outputs, vector=lanes):
    """Decorator: compiled code can call a function of vectors, tuples of vectors and floats. It returns `outputs` vectors, a tuple if > 1."""
    result = vector if outputs == 1 else types.UniTuple(vector, outputs)

    def decorate(function):
        """Let numba type and lower calls of the function by tracing it."""

        @type_callable(function)
        def typed(context):
            """Return the typer of calls, whose result does not depend on the arguments."""

            def typer(*args):
                """Type of the result of a call with any arguments."""
                return result

            typer.pysig = signature(function)
            return typer

        def lower(context, builder, sig, args):
            """Trace the function: each operation of a Traced appends an instruction to the builder."""
            pairs = zip(sig.args, args)
            values = function(
                *(
                    tuple(Traced(builder, builder.extract_value(value, k)) for k in range(len(kind)))
                    if isinstance(kind, types.BaseTuple)
                    else Traced(builder, value)
                    for kind, value in pairs
                )
            )
            return values.value if outputs == 1 else context.make_tuple(builder, result, [v.value for v in values])

        lower_builtin(function, types.VarArg(types.Any))(lower)
        return function

    return decorate


def _spread(builder, value, vector):
    """A number repeated in each lane of an LLVM vector type; a vector unchanged."""
    if value.type == vector:
        return value
    single = builder.insert_element(ir.Constant(vector, ir.Undefined), value, INT32(0))
    return _shuffle(builder, single, single, [0] * vector.count)


def _shuffle(builder, a, b, pattern):
    """Emit a shuffle: the vector of those elements of a and, counted on, of b that `pattern`, a list of indices, names."""
    return builder.shuffle_vector(a, b, ir.Constant(ir.VectorType(INT32, len(pattern)), pattern))


def _joined(builder, parts):
    """Join 2^k vectors of one type to one vector, in their order."""
    while len(parts) > 1:
        span = list(range(2 * parts[0].type.count))
        parts = [_shuffle(builder, a, b, span) for a, b in zip(parts[::2], parts[1::2])]
    return parts[0]


def _address(context, builder, array_type, array, index, element):
    """Pointer of type `element` to item `index` of the array's flat data."""
    return builder.bitcast(builder.gep(context.make_array(array_type)(context, builder, array).data, [index]), element.as_pointer())


def _read(builder, pointer, element):
    """Emit a load from a pointer to `element`, an LLVM type, aligned to 8 bytes for doubles and to 4 otherwise."""
    return builder.load(pointer, align=8 if DOUBLE in (element, getattr(element, "element", None)) else 4)


def _loader(result, element, count, doc):
    """Intrinsic (array, start) -> `count` consecutive `element`s of the flat array."""

    def load(typing_context, array, start):
        """Type of the call and the generator of its code; gets the docstring `doc`."""

        def generate(context, builder, sig, args):
            """Code that reads the elements from the flat array."""
            places = [builder.add(args[1], args[1].type(k * getattr(element, "count", 1))) for k in range(count)]
            values = [_read(builder, _address(context, builder, sig.args[0], args[0], place, element), element) for place in places]
            if element == INT32:
                return builder.sext(values[0], args[1].type)
            return values[0] if count == 1 else context.make_tuple(builder, sig.return_type, values)

        return result(array, types.intp), generate

    load.__doc__ = doc
    return intrinsic(load)


load = _loader(lanes, lanes.element, 1, "One vector of the flat array.")
load2 = _loader(types.UniTuple(lanes, 2), lanes.element, 2, "Two consecutive vectors.")
load3 = _loader(types.UniTuple(lanes, 3), lanes.element, 3, "Three consecutive vectors.")
load4 = _loader(types.UniTuple(lanes, 4), lanes.element, 4, "Four consecutive vectors.")
load8 = _loader(types.UniTuple(lanes, 8), lanes.element, 8, "Eight consecutive vectors.")
load_pair = _loader(pair, pair.element, 1, "Two numbers of the flat array.")
load_float = _loader(types.float64, DOUBLE, 1, "One number of the flat array.")
load_columns = _loader(columns, columns.element, 1, "The 2 COLUMNS numbers of two rows of a flat float32 array (., COLUMNS).")
load_integer = _loader(types.intp, INT32, 1, "One int32 of the flat array.")


def _zeros(count):
    """Intrinsic () -> a tuple of `count` zero vectors."""
    kind = types.UniTuple(lanes, count)

    def zeros(typing_context):
        """Type of the call and the generator of its code."""

        def generate(context, builder, sig, args):
            """Code that makes the tuple of zero vectors."""
            return context.make_tuple(builder, kind, [ir.Constant(lanes.element, None)] * count)

        return kind(), generate

    return intrinsic(zeros)


zeros2, zeros3, zeros4 = _zeros(2), _zeros(3), _zeros(4)


def _zero(vector, doc):
    """Make an intrinsic of no arguments that returns a zero vector of a Vector type."""

    def zero(typing_context):
        """Type of the call and the generator of its code; gets the docstring `doc`."""
        return vector(), lambda context, builder, sig, args: ir.Constant(vector.element, None)

    zero.__doc__ = doc
    return intrinsic(zero)


zero_pair = _zero(pair, "A vector of two zeros, of the type that `load_pair` returns.")
zero_columns = _zero(columns, "A vector of zeros, of the type that `load_columns` returns.")


@intrinsic
def load_spread(typing_context, array, start):
    """The vector of COLUMNS times array[start] and COLUMNS times array[start + 1], of a float32 array; the type is that of `load_columns`."""
    two = ir.VectorType(SINGLE, 2)

    def generate(context, builder, sig, args):
        """Code that loads the two float32 numbers and repeats each of them COLUMNS times."""
        numbers = _read(builder, _address(context, builder, sig.args[0], args[0], args[1], two), two)
        return _shuffle(builder, numbers, numbers, [0] * COLUMNS + [1] * COLUMNS)

    return columns(array, types.intp), generate


@intrinsic
def spread(typing_context, value):
    """A float64 repeated in each lane of a vector."""
    return lanes(types.float64), lambda context, builder, sig, args: _spread(builder, args[0], lanes.element)


@intrinsic
def store(typing_context, array, start, values):
    """Write a tuple of vectors to consecutive places of the flat array."""
    element = values.dtype.element

    def generate(context, builder, sig, args):
        """Code that stores one vector after the other."""
        for k in range(len(values)):
            where = builder.add(args[1], args[1].type(k * element.count))
            pointer = _address(context, builder, sig.args[0], args[0], where, element)
            builder.store(builder.extract_value(args[2], k), pointer, align=8 if element.element == DOUBLE else 4)
        return context.get_dummy_value()

    return types.void(array, types.intp, values), generate


@intrinsic
def lane(typing_context, value, index):
    """One lane of a vector, by its index, as a float64."""
    return types.float64(lanes, types.intp), lambda context, builder, sig, args: builder.extract_element(*args)


def _rows(context, builder, array_type, array, places, width):
    """Pointers to rows of `width` doubles; places = (type of an int32 array of row numbers, the array, start, offset added to the numbers)."""
    place_type, place_array, start, offset = places
    integers = ir.VectorType(INT32, LANES)
    numbers = _read(builder, _address(context, builder, place_type, place_array, start, integers), integers)
    row = ir.VectorType(DOUBLE, width)
    for k in range(LANES):
        number = builder.add(builder.sext(builder.extract_element(numbers, INT32(k)), offset.type), offset)
        yield _address(context, builder, array_type, array, builder.mul(number, number.type(width)), row)


@intrinsic
def gather(typing_context, array, places, start, offset):
    """(array[k, 0], array[k, 1]) for k = places[start : start + LANES] + offset, array (N, 2)."""

    def generate(context, builder, sig, args):
        """Code that reads LANES pairs and sorts them into two vectors."""
        pointers = _rows(context, builder, sig.args[0], args[0], (sig.args[1], *args[1:]), 2)
        pairs = [_read(builder, pointer, pair.element) for pointer in pointers]
        low, high = _joined(builder, pairs[: LANES // 2]), _joined(builder, pairs[LANES // 2 :])
        columns = [_shuffle(builder, low, high, list(range(k, 2 * LANES, 2))) for k in (0, 1)]
        return context.make_tuple(builder, sig.return_type, columns)

    return types.UniTuple(lanes, 2)(array, places, types.intp, types.intp), generate


@intrinsic
def scatter_add(typing_context, array, places, start, offset, values):
    """array[k] += values, one lane after the other, for k = places[start : start + LANES] + offset.

    array (N, 2) takes two vectors; array (N, 2, 2) takes four, [[v0, v1], [v2, v3]].
    """

    def generate(context, builder, sig, args):
        """Code that adds the values row after row, so that values for equal places are added up."""
        columns = [builder.extract_value(args[4], k) for k in range(len(values))]
        where = (sig.args[1], *args[1:4])
        for k, pointer in enumerate(_rows(context, builder, sig.args[0], args[0], where, len(columns))):
            halves = [_shuffle(builder, a, b, [k, LANES + k]) for a, b in zip(columns[::2], columns[1::2])]
            row = _joined(builder, halves)
            builder.store(builder.fadd(_read(builder, pointer, row.type), row), pointer, align=8)
        return context.get_dummy_value()

    return types.void(array, places, types.intp, types.intp, values), generate


@intrinsic
def add_pair(typing_context, array, start, value):
    """Add a pair of doubles to two entries: array.flat[start : start + 2] += value."""

    def generate(context, builder, sig, args):
        """Code that loads the two doubles, adds the pair and stores the sum."""
        pointer = _address(context, builder, sig.args[0], args[0], args[1], pair.element)
        builder.store(builder.fadd(_read(builder, pointer, pair.element), args[2]), pointer, align=8)
        return context.get_dummy_value()

    return types.void(array, types.intp, pair), generate


def _place(context, builder, kind, value):
    """The address of the first entry of an array, or of the block of a pack, as an int64; 0 of None."""
    if kind == types.none:
        return ir.Constant(INT64, 0)
    return builder.ptrtoint(context.make_array(kind)(context, builder, value).data if isinstance(kind, types.Array) else value, INT64)


@intrinsic
def call(typing_context, function, arguments):
    """Call the C function at address `function` with a tuple of at most eight arguments; return its int64.

    It gets the address of an array or a pack, 0 for None, the bits of a float, and an integer as it is; arguments that are missing are 0.
    """

    def integer(context, builder, kind, value):
        """Code that makes an int64 of one argument: the value of an integer, the bits of a float, or the address of an array or a pack."""
        if isinstance(kind, types.Integer | types.Boolean):
            return context.cast(builder, value, kind, types.int64)
        return builder.bitcast(value, INT64) if isinstance(kind, types.Float) else _place(context, builder, kind, value)

    def generate(context, builder, sig, args):
        """Code that calls the function at the address with ARGUMENTS int64 values; missing ones are 0."""
        given = [integer(context, builder, kind, builder.extract_value(args[1], k)) for k, kind in enumerate(arguments)]
        signature = ir.FunctionType(INT64, [INT64] * ARGUMENTS)
        return builder.call(builder.inttoptr(args[0], signature.as_pointer()), given + [INT64(0)] * (ARGUMENTS - len(given)))

    return types.int64(types.int64, arguments), generate


@intrinsic
def address(typing_context, value):
    """Address of the first entry of an array, or of the block of a pack; 0 of None."""

    def generate(context, builder, sig, args):
        """Code that reads the address as an int64."""
        return _place(context, builder, value, args[0])

    return types.int64(value), generate


@intrinsic
def integer_of(typing_context, number):
    """The int64 with the bits of a float64: an argument of `call`."""
    return types.int64(types.float64), lambda context, builder, sig, args: builder.bitcast(args[0], INT64)


@intrinsic
def float_of(typing_context, bits):
    """The float64 with the bits of an int64, the inverse of `integer_of`."""
    return types.float64(types.int64), lambda context, builder, sig, args: builder.bitcast(args[0], DOUBLE)


@intrinsic
def real(typing_context, number):
    """Read the float64 at an address in memory."""
    return types.float64(types.int64), lambda context, builder, sig, args: builder.load(builder.inttoptr(args[0], DOUBLE.as_pointer()))


def pointer_to(item):
    """Intrinsic (address) -> pointer to items of a numba type."""
    kind = types.CPointer(item)

    @intrinsic
    def pointer(typing_context, number):
        """The int64 address `number` as a pointer to items of that type."""
        return kind(types.int64), lambda context, builder, sig, args: builder.inttoptr(args[0], context.get_value_type(kind))

    return pointer


@intrinsic
def seen(typing_context, numbers, at):
    """Atomic load of numbers[at], int64, with acquire order: all that another thread wrote before its `leave` of that number is seen too."""

    def generate(context, builder, sig, args):
        """Code of the atomic load with acquire order."""
        return builder.load_atomic(_address(context, builder, sig.args[0], args[0], args[1], INT64), "acquire", 8)

    return types.int64(numbers, types.int64), generate


@intrinsic
def leave(typing_context, numbers, at, number):
    """Atomic store numbers[at] = number, int64, visible to other threads."""

    def generate(context, builder, sig, args):
        """Code of the atomic store with release order."""
        builder.store_atomic(args[2], _address(context, builder, sig.args[0], args[0], args[1], INT64), "release", 8)
        return context.get_dummy_value()

    return types.void(numbers, types.int64, types.int64), generate


@intrinsic
def yield_core(typing_context):
    """Let the operating system run another thread on this core, if one waits for it."""
    name = "SwitchToThread" if sys.platform == "win32" else "sched_yield"

    def generate(context, builder, sig, args):
        """Code that calls the C function `name` of the operating system, and ignores its result."""
        function = builder.module.globals.get(name) or ir.Function(builder.module, ir.FunctionType(INT32, []), name)
        builder.call(function, [])
        return context.get_dummy_value()

    return types.void(), generate


pointer, complex_pointer, integers = (pointer_to(kind) for kind in (types.float64, types.complex128, types.int64))
