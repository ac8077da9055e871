"""What compiled code takes of numba's inside, in one place: it may be another in any version."""

import numba

try:
    from llvmlite import ir
    from numba.core import typed_passes, types, untyped_passes
    from numba.core.base import BaseContext
    from numba.core.codegen import JITCodeLibrary
    from numba.core.compiler import Compiler, Flags
    from numba.core.compiler_machinery import PassManager
    from numba.core.ir import Inst, Loc, Var
    from numba.core.registry import CPUDispatcher
    from numba.core.types.functions import BaseFunction
    from numba.core.typing.templates import AbstractTemplate, AttributeTemplate, infer_getattr, infer_global, signature
    from numba.extending import NativeValue, intrinsic, lower_builtin, lower_getattr_generic, models, register_model, typeof_impl, unbox
    from numba.np.arrayobj import populate_array
except ImportError as error:
    raise ImportError(
        f"polyida compiles by numba's internals, which are others in numba {numba.__version__} ({error}); "
        "install a version between the bounds that polyida declares (pip install --force-reinstall polyida)"
    ) from error

__all__ = [
    "AbstractTemplate",
    "AttributeTemplate",
    "BaseContext",
    "BaseFunction",
    "CPUDispatcher",
    "Compiler",
    "Flags",
    "Inst",
    "JITCodeLibrary",
    "Loc",
    "NativeValue",
    "PassManager",
    "Var",
    "infer_getattr",
    "infer_global",
    "intrinsic",
    "ir",
    "lower_builtin",
    "lower_getattr_generic",
    "models",
    "populate_array",
    "register_model",
    "signature",
    "typed_passes",
    "typeof_impl",
    "types",
    "unbox",
    "untyped_passes",
]
