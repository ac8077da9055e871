"""The style of the gallery's figures: that of polyida's own, for those that an example draws with matplotlib alone."""

from polyida.show.styles import STYLE_FILE


def use_style(gallery_conf, file):
    """Set matplotlib's settings before an example runs; sphinx-gallery calls it."""
    from matplotlib import pyplot

    pyplot.style.use(STYLE_FILE)
