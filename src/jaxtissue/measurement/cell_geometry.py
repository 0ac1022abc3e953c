"""Geometric measures of cells: volumes, areas and perimeters with estimated errors, shown as numbers or as a table.

"The paper" is Buceta, Funke, Storandt, "Efficient Modeling of 3D Epithelial Cell Structure Dynamics via Backbone
Spreads", GRAPP 2025.
"""

from typing import Any

import equinox as eqx
import numpy as np
from jax.core import Tracer
from jaxtyping import Array, Bool, Float

from jaxtissue.system.frames import as_frame

SIZES = ("volume", "lateral_area", "apical_area", "basal_area", "apical_perimeter", "basal_perimeter")


class CellGeometry(eqx.Module):
    """Volumes, areas and perimeters of the cells of a tissue (paper, section 3.1).

    Lengths are in the length unit of the domain, areas in its square, volumes in its cube. All arrays have one entry
    per cell. Fields that were not measured are None: the four on the surfaces if `surfaces=False`, and the two errors
    if `refine=False` or if the cells come from `CellMeasurer`. Only `measure_tissue` sets `tiling_defect`.

    Attributes:
        volume: V_i, volume of each cell, shape [cells].
        lateral_area: A_i, area of the walls that each cell shares with other cells, shape [cells]. The apical and basal
            faces and the faces at the ends of the domain are not included.
        apical_area: Area of each cell on the apical surface, shape [cells].
        basal_area: Area of each cell on the basal surface, shape [cells].
        apical_perimeter: Length of the edges that each cell shares with other cells on the apical surface, shape
            [cells]. Edges along the ends of the domain are not included.
        basal_perimeter: Length of the edges that each cell shares with other cells on the basal surface, shape [cells].
            Edges along the ends of the domain are not included.
        touches_end: Whether each cell touches an end of the domain (in a tube x = 0 or x = L), booleans, shape [cells].
        volume_error: Estimated absolute error of each volume, shape [cells]. The estimate exceeds the true error for
            most cells, but it is not a strict bound.
        lateral_area_error: Estimated absolute error of each lateral area, shape [cells]. Not a strict bound either.
        tiling_defect: Scalar measure of the completeness of the neighbor lists: the largest relative deviation, over
            all quadrature lines, of the summed segment lengths of the cells from the full length of the line. Zero up
            to round-off if no neighbor is missing. On domains other than `Tube` it compares the summed sections with
            whole layers, and also contains the error of the sections.
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
        """Return only the measures that an energy function may read.

        Args:
            has_surfaces: Whether to include areas and perimeters on the apical and basal surface.

        Returns:
            Volumes and lateral areas, with the measures on the surfaces or None in their place; all other fields are
            None.
        """
        surfaces = (self.apical_area, self.basal_area, self.apical_perimeter, self.basal_perimeter)
        return CellGeometry(self.volume, self.lateral_area, *surfaces * has_surfaces)

    def to_pandas(self) -> Any:
        """Convert to a pandas `DataFrame` with one row per cell.

        Returns:
            A table with one column for each field that was measured, except `tiling_defect`.

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
