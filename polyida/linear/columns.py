"""Four float32 numbers as one element of an array in compiled code: code for arrays of numbers then works on four right-hand sides at once."""

import operator

from llvmlite import ir
from numba import types
from numba.extending import intrinsic, lower_builtin, models, register_model, type_callable

COLUMNS = 4
FLAGS = ("contract", "reassoc", "nsz")


class Columns(types.Type):
    """COLUMNS float32 held in a register."""

    element = ir.VectorType(ir.FloatType(), COLUMNS)

    def __init__(self):
        super().__init__(name="Columns")


@register_model(Columns)
class ColumnsModel(models.PrimitiveModel):
    """An LLVM vector."""

    def __init__(self, dmm, fe_type):
        super().__init__(dmm, fe_type, fe_type.element)


def _spread(builder, value):
    """A number in each column; columns unchanged."""
    vector = Columns.element
    if value.type == vector:
        return value
    value = value if value.type == vector.element else builder.fptrunc(value, vector.element)
    single = builder.insert_element(ir.Constant(vector, ir.Undefined), value, ir.IntType(32)(0))
    return builder.shuffle_vector(single, single, ir.Constant(ir.VectorType(ir.IntType(32), COLUMNS), [0] * COLUMNS))


def _register(function, result, lower):
    """Let compiled code call an operator for two Columns, or Columns and a number."""

    @type_callable(function)
    def typed(context):
        def typer(a, b):
            both = all(isinstance(kind, (Columns, types.Float)) for kind in (a, b))
            return result if both and any(isinstance(kind, Columns) for kind in (a, b)) else None

        return typer

    for kinds in ((Columns, Columns), (Columns, types.Float), (types.Float, Columns)):
        lower_builtin(function, *kinds)(lower)


def _arithmetic(instruction):
    return lambda context, builder, sig, args: getattr(builder, instruction)(*(_spread(builder, value) for value in args), flags=FLAGS)


def _differs(context, builder, sig, args):
    bits = builder.fcmp_unordered("!=", *(_spread(builder, value) for value in args))
    return builder.icmp_unsigned("!=", builder.bitcast(bits, ir.IntType(COLUMNS)), ir.IntType(COLUMNS)(0))


for names, instruction in ((("add", "iadd"), "fadd"), (("sub", "isub"), "fsub"), (("mul", "imul"), "fmul")):
    for name in names:
        _register(getattr(operator, name), Columns(), _arithmetic(instruction))
_register(operator.ne, types.boolean, _differs)  # in any column


@intrinsic
def zero_of(typing_context, value):
    """Zero of the type of a value."""
    return value(value), lambda context, builder, sig, args: ir.Constant(args[0].type, None)


@intrinsic
def as_columns(typing_context, array):
    """A contiguous array (n, COLUMNS) of float32 as an array (n,) of Columns. The caller keeps the memory alive."""
    kind = types.Array(Columns(), 1, "C")

    def generate(context, builder, sig, args):
        given, result, word = (
            context.make_array(array)(context, builder, args[0]),
            context.make_array(kind)(context, builder),
            ir.IntType(64),
        )
        length, size, single = builder.extract_value(given.shape, 0), word(4 * COLUMNS), types.UniTuple(types.intp, 1)
        result.data, result.itemsize, result.nitems = builder.bitcast(given.data, result.data.type), size, length
        result.shape, result.strides = (context.make_tuple(builder, single, [number]) for number in (length, size))
        return result._getvalue()

    return kind(array), generate
