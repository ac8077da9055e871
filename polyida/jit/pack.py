"""Named tuples that compiled code receives as one pointer: passing them costs one register, whatever their size.

numba passes each array of a tuple as seven values, in every call at every level; a scene and its workspace are several hundred values. A pack
stores the addresses and shapes of its arrays in one block of words; `s.weights` in compiled code reads them from the block. The block never
changes, and LLVM is told so: it moves the reads out of loops.

None takes a word, like a pack: code that does not read a field may be compiled for the type with None there, and serves blocks with both.
"""

import hashlib
from ctypes import addressof, c_char
from functools import cached_property
from itertools import count
from struct import pack as struct
from struct import unpack

import numpy as np
from numba import types
from numba.extending import NativeValue, lower_getattr_generic, models, register_model, typeof_impl, unbox

WORD = 8  # bytes


def pack(cls):
    """Decorator of a NamedTuple class. Fields are arrays, numbers, packs or None."""
    return type(cls.__name__, (_Packed, cls), {"__doc__": cls.__doc__, "__module__": cls.__module__, "__qualname__": cls.__qualname__})


class _Packed:
    """A named tuple with its block."""

    @cached_property
    def address(self):
        """Address of the block, an int; the block lives as long as the tuple."""
        block = np.array([word for value in self for word in _words(value)] or [0], np.int64)
        return vars(self).setdefault("_block", block).ctypes.data  # if two threads meet here, both use the first block

    def __reduce__(self):
        """Pickle the pack by its fields; the block is made anew."""
        return type(self), tuple(self)


def _words(value):
    """The 8-byte words that stand for the value of a field in the block."""
    if isinstance(value, float):
        return unpack("q", struct("d", value))
    if isinstance(value, np.ndarray):
        try:
            at = addressof(c_char.from_buffer(value))  # in a fifth of the time of the other way
        except (TypeError, ValueError):  # read-only, empty or not contiguous
            at = value.__array_interface__["data"][0]
        return at, *value.shape, *value.strides
    if isinstance(value, _Packed):
        return (value.address,)
    if value is None:
        return (0,)
    return (int(value),) if isinstance(value, int | np.integer | np.bool_) else unpack("q", struct("d", value))


class PackType(types.BaseNamedTuple):
    """The numba type of a pack with fields (name, type). numba reads types of attributes of named tuples through `fields` and `[]`."""

    def __init__(self, label, fields):
        """Take a label and (name, type) of each field, in their order."""
        self.fields, self.types = tuple(name for name, _ in fields), tuple(kind for _, kind in fields)
        positions = np.cumsum([0, *map(_size, self.types)])
        self.positions = dict(zip(self.fields, zip(self.types, map(int, positions))))  # {name: (type, first word in the block)}
        self.number = next(_numbers)  # of this object, for `_form`
        super().__init__(name=f"{label}_{hashlib.sha256(repr(fields).encode()).hexdigest()[:16]}")

    def __getitem__(self, number):
        """The numba type of the field with that number."""
        return self.types[number]

    def __len__(self):
        """The number of fields of the pack."""
        return len(self.types)


def _size(kind):
    """Number of 8-byte words of a field of a type in the block."""
    return 1 + 2 * kind.ndim if isinstance(kind, types.Array) else 1


@typeof_impl.register(_Packed)
def _type_of(value, context):
    """The PackType of a pack; one object for all packs of the same form."""
    known = vars(value)
    if "_kind" not in known:
        form = type(value), *[_form(field, context) for field in value]
        if form not in _kinds:
            kinds = [typeof_impl(field, context) for field in value]
            words = [types.float64 if isinstance(k, types.Float) else types.int64 if isinstance(k, types.Integer) else k for k in kinds]
            _kinds.setdefault(form, PackType(type(value).__name__, tuple(zip(value._fields, words))))
        known["_kind"] = _kinds[form]
    return known["_kind"]


_kinds: dict[tuple, PackType] = {}  # by forms: numba itself takes many times as long to find the types of arrays
_numbers = count()


PLAIN = frozenset((float, int, bool, type(None), np.float64, np.int64, np.bool_))


def form_of(value):
    """All that determines the type of an argument of compiled code, or None if it is unknown."""
    kind = type(value)
    if kind is np.ndarray:
        return value.dtype.num, value.ndim, value.flags.num
    if kind in PLAIN:
        return kind
    return _type_of(value, None).number if isinstance(value, _Packed) else None


def _form(field, context):
    """All that determines the type of a field. Numbers: hashes of numba's types and of dtypes take longer than the rest."""
    if isinstance(field, np.ndarray):
        return field.dtype.num, field.ndim, field.flags.num
    return _type_of(field, context).number if isinstance(field, _Packed) else type(field)


register_model(PackType)(models.OpaqueModel)  # the address of the block


@unbox(PackType)
def _unboxed(kind, value, c):
    """The address of a pack's block as a native value, read from the Python object by emitted code."""
    number = c.pyapi.object_getattr_string(value, "address")
    address = c.pyapi.long_as_voidptr(number)
    c.pyapi.decref(number)
    return NativeValue(address)


@lower_getattr_generic(PackType)
def _field(context, builder, kind, block, name):
    """Emit code that reads the field of that name from the block of a pack."""
    (field, position), integer, words = kind.positions[name], context.get_value_type(types.int64), []
    for k in range(position, position + _size(field)):
        words.append(builder.load(builder.bitcast(builder.gep(block, [integer(WORD * k)]), integer.as_pointer())))
        words[-1].set_metadata("invariant.load", builder.module.add_metadata([]))
    if isinstance(field, types.Array):
        return _array(context, builder, field, words)
    if isinstance(field, PackType):
        return builder.inttoptr(words[0], block.type)
    if field is types.none:
        return context.get_dummy_value()
    if isinstance(field, types.Boolean):
        return builder.trunc(words[0], context.get_value_type(field))
    return builder.bitcast(words[0], context.get_value_type(field))


def _array(context, builder, kind, words):
    """Emit code that makes an array, whose memory Python owns, of its words in a block."""
    array, size = context.make_array(kind)(context, builder), words[0].type(context.get_abi_sizeof(context.get_data_type(kind.dtype)))
    items, lengths = words[0].type(1), types.UniTuple(types.int64, kind.ndim)
    for length in words[1 : 1 + kind.ndim]:
        items = builder.mul(items, length)
    array.data, array.itemsize, array.nitems = builder.inttoptr(words[0], array.data.type), size, items
    array.shape = context.make_tuple(builder, lengths, words[1 : 1 + kind.ndim])
    array.strides = context.make_tuple(builder, lengths, words[1 + kind.ndim :])
    return array._getvalue()
