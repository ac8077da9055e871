"""`pi.show`: pictures and animations of runs.

`RunPlots` is `run.plot`. `animation` writes GIF and MP4. `settings`, `figure` and `save` make other figures in the style of this package.
"""

from importlib import import_module

_MODULES = {"RunPlots": "plots", "animation": "animations", "settings": "style", "figure": "style", "save": "style"}
__all__ = list(_MODULES)


def __getattr__(name):
    if name not in _MODULES:
        raise AttributeError(f"module 'polyida.show' has no attribute {name!r}")
    return getattr(import_module(f"polyida.show.{_MODULES[name]}"), name)


def __dir__():
    return sorted(__all__)
