"""Named tuples that compiled code takes by one pointer: whatever they hold, handing them on costs a register.

numba spells a tuple of arrays out in every call, seven values an array: a scene and its scratch are several hundred, at every level of
every call, and most of what it compiles is that. A pack keeps the addresses and shapes of its arrays in a block of words, made once;
`s.weights` in compiled code reads it from there. The block never changes, which the reads tell LLVM: they leave its loops.
"""

import hashlib
from functools import cached_property

import numpy as np
from numba import types
from numba.extending import NativeValue, lower_getattr_generic, models, register_model, typeof_impl, unbox

WORD = 8  # bytes


def pack(cls):
    """The named tuple class, its instances made ready for compiled code; fields are arrays, numbers, packs or None."""
    return type(cls.__name__, (_Packed, cls), {"__doc__": cls.__doc__, "__module__": cls.__module__, "__qualname__": cls.__qualname__})


class _Packed:
    """A tuple that knows its block."""

    @cached_property
    def address(self):
        """Of the block, which is kept as long as the tuple."""
        words: list[int] = []
        for value in self:
            words += _words(value)
        block = np.array(words or [0], np.uint64)
        return vars(self).setdefault("_block", block).ctypes.data  # the first block stays, whichever thread made it

    def __reduce__(self):
        return type(self), tuple(self)


def _words(value):
    """What a block holds of a field."""
    if isinstance(value, np.ndarray):
        words = [value.__array_interface__["data"][0], *value.shape, *value.strides]
        return words if min(words) >= 0 else [word % 2**64 for word in words]
    if value is None:
        return []
    if isinstance(value, _Packed):
        return [value.address]
    return [int(value) % 2**64 if isinstance(value, int | np.integer | np.bool_) else int(np.array(value, float).view(np.uint64))]


class PackType(types.BaseNamedTuple):
    """A pack of fields (name, type). numba finds the types of attributes of named tuples by `fields` and `[]`."""

    def __init__(self, label, fields):
        self.fields, self.types = tuple(name for name, _ in fields), tuple(kind for _, kind in fields)
        places = np.cumsum([0, *map(_size, self.types)])
        self.places = dict(zip(self.fields, zip(self.types, map(int, places))))  # where in the block each begins
        super().__init__(name=f"{label}_{hashlib.sha256(repr(fields).encode()).hexdigest()[:16]}")

    def __getitem__(self, number):
        return self.types[number]

    def __len__(self):
        return len(self.types)


def _size(kind):
    """Words of a field."""
    if isinstance(kind, types.Array):
        return 1 + 2 * kind.ndim
    return 0 if kind is types.none else 1


@typeof_impl.register(_Packed)
def _type_of(value, context):
    known = vars(value)
    if "_kind" not in known:
        form = type(value), *[_form(field, context) for field in value]
        known["_kind"] = _kinds.get(form) or _kinds.setdefault(form, _made_of(value, context))
    return known["_kind"]


_kinds: dict[tuple, PackType] = {}  # by what they follow from: numba takes many times as long to tell the types of arrays


def _form(field, context):
    """What the type of a field follows from."""
    if isinstance(field, np.ndarray):
        return field.dtype, field.ndim, field.flags.num
    return _type_of(field, context) if isinstance(field, _Packed) else type(field)


def _made_of(value, context):
    return PackType(type(value).__name__, tuple((name, _kind(typeof_impl(field, context))) for name, field in zip(value._fields, value)))


def _kind(kind):
    """The type of a field: of numbers, that of a word."""
    return types.float64 if isinstance(kind, types.Float) else types.int64 if isinstance(kind, types.Integer) else kind


register_model(PackType)(models.OpaqueModel)  # the address of the block


@unbox(PackType)
def _unboxed(kind, value, c):
    number = c.pyapi.object_getattr_string(value, "address")
    address = c.pyapi.long_as_voidptr(number)
    c.pyapi.decref(number)
    return NativeValue(address)


@lower_getattr_generic(PackType)
def _field(context, builder, kind, block, name):
    """A field, read from the block."""
    field, place = kind.places[name]
    words = [_word(context, builder, block, place + k) for k in range(_size(field))]
    if isinstance(field, types.Array):
        return _array(context, builder, field, words)
    if isinstance(field, PackType):
        return builder.inttoptr(words[0], block.type)
    if field is types.none:
        return context.get_dummy_value()
    if isinstance(field, types.Boolean):
        return builder.trunc(words[0], context.get_value_type(field))
    return builder.bitcast(words[0], context.get_value_type(field))


def _word(context, builder, block, place):
    """A word of the block, which nothing writes to."""
    kind = context.get_value_type(types.int64)
    word = builder.load(builder.bitcast(builder.gep(block, [kind(WORD * place)]), kind.as_pointer()))
    word.set_metadata("invariant.load", builder.module.add_metadata([]))
    return word


def _array(context, builder, kind, words):
    """An array that Python keeps."""
    array, size = context.make_array(kind)(context, builder), words[0].type(context.get_abi_sizeof(context.get_data_type(kind.dtype)))
    items, lengths = words[0].type(1), types.UniTuple(types.int64, kind.ndim)
    for length in words[1 : 1 + kind.ndim]:
        items = builder.mul(items, length)
    array.data, array.itemsize, array.nitems = builder.inttoptr(words[0], array.data.type), size, items
    array.shape = context.make_tuple(builder, lengths, words[1 : 1 + kind.ndim])
    array.strides = context.make_tuple(builder, lengths, words[1 + kind.ndim :])
    return array._getvalue()
