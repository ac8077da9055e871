"""An HTML page of blocks: one file that stands alone, light and dark, for a screen, a phone, paper and the keyboard."""

from polyida.show.html.blocks import Heading, Notes, Picture, Table, Text
from polyida.show.html.movie import Movie
from polyida.show.html.page import write

__all__ = ["Heading", "Movie", "Notes", "Picture", "Table", "Text", "write"]
