"""`pi.show`: pictures and animations of runs.

`RunPlots` is `run.plot`. `animation` writes GIF, MP4, SVG and HTML. `with style("paper"):` makes figures
for a journal; `settings`, `figure` and `save` make other figures in the style of this package.
"""

from polyida import registry

_PLACES = registry.places(
    __name__, {"plots": ("RunPlots",), "animations": ("animation", "Animation"), "styles": ("style", "settings", "figure", "save")}
)
__all__ = list(_PLACES)
__getattr__, __dir__ = registry.attributes(__name__, _PLACES)
