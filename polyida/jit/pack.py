"""Named tuples that compiled code takes by one pointer: whatever they hold, handing them on costs a register.

numba spells a tuple of arrays out in every call, seven values an array: a scene and its scratch are several hundred, at every level of
every call, and most of what it compiles is that. A pack keeps the addresses and shapes of its arrays in a block of words, made once;
`s.weights` in compiled code reads it from there. The block never changes, which the reads tell LLVM: they leave its loops.
"""

import hashlib
from functools import cached_property

import numpy as np

from polyida.jit.internals import (
    AttributeTemplate,
    NativeValue,
    infer_getattr,
    ir,
    lower_getattr_generic,
    models,
    populate_array,
    register_model,
    typeof_impl,
    types,
    unbox,
)

WORD = ir.IntType(64)


def pack(cls):
    """The named tuple class, its instances made ready for compiled code; fields are arrays, numbers, packs or None."""
    return type(cls.__name__, (_Packed, cls), {"__doc__": cls.__doc__, "__module__": cls.__module__, "__qualname__": cls.__qualname__})


class _Packed:
    """A tuple that knows its block."""

    @cached_property
    def address(self):
        """Of the block, which is kept as long as the tuple."""
        block = np.array([word for value in self for word in _words(value)] or [0], np.uint64)
        return vars(self).setdefault("_block", block).ctypes.data  # the first block stays, whichever thread made it

    def __reduce__(self):
        return type(self), tuple(self)


def _words(value):
    """What a block holds of a field."""
    if isinstance(value, np.ndarray):
        return [value.ctypes.data, *value.shape, *(stride % 2**64 for stride in value.strides)]
    if value is None:
        return []
    if isinstance(value, _Packed):
        return [value.address]
    return [int(value) % 2**64 if isinstance(value, int | np.integer | np.bool_) else int(np.array(value, float).view(np.uint64))]


class PackType(types.Type):
    """A pack with fields of these names and types; places: where in the block each begins."""

    def __init__(self, label, fields):
        self.fields, place = {}, 0
        for name, kind in fields:
            self.fields[name] = kind, place
            place += _size(kind)
        digest = hashlib.sha256(repr(fields).encode()).hexdigest()[:16]
        super().__init__(name=f"{label}_{digest}")


def _size(kind):
    """Words of a field."""
    if isinstance(kind, types.Array):
        return 1 + 2 * kind.ndim
    return 0 if kind is types.none else 1


@typeof_impl.register(_Packed)
def _type_of(value, context):
    return vars(value).get("_kind") or vars(value).setdefault("_kind", _made_of(value, context))


def _made_of(value, context):
    return PackType(type(value).__name__, tuple((name, _kind(typeof_impl(field, context))) for name, field in zip(value._fields, value)))


def _kind(kind):
    """The type of a field: of numbers, that of a word."""
    return types.float64 if isinstance(kind, types.Float) else types.int64 if isinstance(kind, types.Integer) else kind


@register_model(PackType)
class _Model(models.PrimitiveModel):
    """The address of the block."""

    def __init__(self, manager, kind):
        super().__init__(manager, kind, WORD.as_pointer())


@unbox(PackType)
def _unboxed(kind, value, c):
    number = c.pyapi.object_getattr_string(value, "address")
    address = c.pyapi.long_as_voidptr(number)
    c.pyapi.decref(number)
    return NativeValue(c.builder.bitcast(address, WORD.as_pointer()))


@infer_getattr
class _Fields(AttributeTemplate):
    key = PackType

    def generic_resolve(self, kind, name):
        """The type of a field."""
        return kind.fields[name][0] if name in kind.fields else None


@lower_getattr_generic(PackType)
def _field(context, builder, kind, block, name):
    """A field, read from the block."""
    field, place = kind.fields[name]
    words = [_word(builder, block, place + k) for k in range(_size(field))]
    if isinstance(field, types.Array):
        return _array(context, builder, field, words)
    if isinstance(field, PackType):
        return builder.inttoptr(words[0], WORD.as_pointer())
    if field is types.none:
        return context.get_dummy_value()
    if isinstance(field, types.Boolean):
        return builder.trunc(words[0], ir.IntType(1))
    return builder.bitcast(words[0], context.get_value_type(field))


def _word(builder, block, place):
    """A word of the block, which nothing writes to."""
    word = builder.load(builder.gep(block, [WORD(place)]))
    word.set_metadata("invariant.load", builder.module.add_metadata([]))
    return word


def _array(context, builder, kind, words):
    """An array that Python keeps."""
    array, size = context.make_array(kind)(context, builder), context.get_abi_sizeof(context.get_data_type(kind.dtype))
    data = builder.inttoptr(words[0], array.data.type)
    populate_array(array, data, words[1 : 1 + kind.ndim], words[1 + kind.ndim :], WORD(size), None)
    return array._getvalue()
