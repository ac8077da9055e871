"""Numbers by which threads of compiled code wait for each other: whoever sees one sees all that was written before it was left."""

from polyida.jit.internals import intrinsic, signature, types

WIDTH = 8  # bytes of a number


@intrinsic
def seen(typing, numbers, at):
    """numbers[at], int64, as it is now."""

    def made(context, builder, sig, args):
        return builder.load_atomic(_place(context, builder, sig, args), "acquire", WIDTH)

    return signature(types.int64, numbers, types.int64), made


@intrinsic
def leave(typing, numbers, at, number):
    """numbers[at] = number, int64, for others to see."""

    def made(context, builder, sig, args):
        builder.store_atomic(args[2], _place(context, builder, sig, args), "release", WIDTH)
        return context.get_dummy_value()

    return signature(types.none, numbers, types.int64, types.int64), made


def _place(context, builder, sig, args):
    """Address of an entry of a contiguous array."""
    return builder.gep(context.make_array(sig.args[0])(context, builder, args[0]).data, [args[1]])
