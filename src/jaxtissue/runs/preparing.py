"""Parts of the figures of a run that are prepared before its last sweep, while the device computes."""

from contextlib import suppress
from threading import Thread
from typing import Any

import numpy as np
from jaxtyping import Float

from jaxtissue.geometry.domains import Domain
from jaxtissue.geometry.tube import Tube


class Preparation:
    """A thread that imports what draws, reads the fonts, and finds the cells of the first tissue's surfaces.

    Attributes:
        maps: Those of the first tissue, by surface, once it is `done`; None where that failed, and is told later.
    """

    def __init__(self, first: Float[np.ndarray, "n d"], domain: Tube | Domain, flat: bool) -> None:
        self.maps: dict[str, list[Any]] | None = None
        self._thread = Thread(target=self._prepare, args=(first, domain, flat), daemon=True)
        self._thread.start()

    def done(self) -> "Preparation":
        """This, at its end."""
        self._thread.join()
        return self

    def _prepare(self, first: Float[np.ndarray, "n d"], domain: Tube | Domain, flat: bool) -> None:
        with suppress(Exception):  # whoever draws will fail as well, and tell
            from jaxtissue.runs import plots
            from jaxtissue.runs.viewing import import_pictures

            plots.read_fonts()
            if not flat and isinstance(domain, Tube):
                import_pictures()
            self.maps = plots.map_surfaces(first, domain)
