"""The sizes of cells as one value, which shows its numbers and becomes a table."""

from typing import Any

import equinox as eqx
import numpy as np
from jax.core import Tracer
from jaxtyping import Array, Bool, Float

from jaxtissue.system.frames import as_frame


class CellGeometry(eqx.Module):
    """The sizes of each cell (paper, section 3.1), in the unit of the tube's lengths, its square and its cube.

    Areas and perimeters on the two surfaces are None where the lines do not include the surfaces, and the errors are
    None except for whole tissues that `measure_tissue` refined.

    Attributes:
        volume: V_i, the volume of each cell, [cells].
        lateral_area: A_i, the area of its walls with other cells; surfaces and ends of the tube are not counted,
            [cells].
        apical_area: The area of its part of the apical surface, [cells].
        basal_area: The area of its part of the basal surface, [cells].
        apical_perimeter: The length of its edges with other cells on the apical surface, [cells]; the circles at the
            ends of the tube are not counted.
        basal_perimeter: The same on the basal surface, [cells].
        touches_end: Whether it touches an end plane, x = 0 or x = L, [cells].
        volume_error: An estimated bound of the error of its volume, in the unit of volume, which most cells keep,
            [cells].
        lateral_area_error: The same for its lateral area, in the unit of area, [cells].
        tiling_defect: The largest relative error of the cells' lengths summed along a line: 0 to rounding where no
            neighbor was missing.
    """

    volume: Float[Array, "cells"]
    lateral_area: Float[Array, "cells"]
    apical_area: Float[Array, "cells"] | None = None
    basal_area: Float[Array, "cells"] | None = None
    apical_perimeter: Float[Array, "cells"] | None = None
    basal_perimeter: Float[Array, "cells"] | None = None
    touches_end: Bool[Array, "cells"] | None = None
    volume_error: Float[Array, "cells"] | None = None
    lateral_area_error: Float[Array, "cells"] | None = None
    tiling_defect: Float[Array, ""] | None = None

    def of_energy(self, has_surfaces: bool) -> "CellGeometry":
        """The sizes that an energy may read: volumes and lateral areas, and those on the surfaces or None for them."""
        surfaces = (self.apical_area, self.basal_area, self.apical_perimeter, self.basal_perimeter)
        return CellGeometry(self.volume, self.lateral_area, *surfaces * has_surfaces)

    def to_pandas(self) -> Any:
        """The sizes as a pandas `DataFrame`, with one row for each cell.

        Returns:
            A table with a column for each size that was measured.

        Raises:
            ImportError: If pandas is not installed.
        """
        return as_frame(self._columns())

    def _has_numbers(self) -> bool:
        return isinstance(self.volume, np.ndarray | Array) and not isinstance(self.volume, Tracer)

    def _columns(self) -> dict[str, np.ndarray]:
        """The sizes that were measured, by name."""
        columns = {name: getattr(self, name) for name in self.__dataclass_fields__ if name != "tiling_defect"}
        return {name: np.asarray(column) for name, column in columns.items() if column is not None}

    def __repr__(self) -> str:
        if not self._has_numbers():
            return eqx.tree_pformat(self)
        columns = self._columns()
        told = [f"{name} {column.mean():.4g} +- {column.std():.2g}" for name, column in columns.items() if column.size]
        return f"CellGeometry({np.size(self.volume)} cells: {', '.join(told[:2])})"

    def _repr_html_(self) -> str | None:
        if not self._has_numbers():
            return None
        lines = ["<tr><th></th><th>mean</th><th>sd</th><th>least</th><th>largest</th></tr>"]
        for name, column in self._columns().items():
            if column.size and column.dtype != bool:
                values = (
                    f"<td>{value:.4g}</td>" for value in (column.mean(), column.std(), column.min(), column.max())
                )
                lines.append(f"<tr><th>{name.replace('_', ' ')}</th>{''.join(values)}</tr>")
        return f"<table><caption>{np.size(self.volume)} cells</caption>{''.join(lines)}</table>"
