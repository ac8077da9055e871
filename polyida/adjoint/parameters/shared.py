"""What several parameters of one model take from one Work, made once."""

from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Any


@dataclass(eq=False)
class Shared:
    """`make(model, work)`, kept for the last Work that it was asked for."""

    make: Callable[[Any, Any], Any]
    model: Any
    _last: tuple = field(default=(None, None), init=False)

    def __call__(self, work):
        if self._last[0] is not work:
            self._last = work, self.make(self.model, work)
        return self._last[1]
