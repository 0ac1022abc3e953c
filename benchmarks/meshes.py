"""Cell meshes: volumes against the traced ones, their sum, triangles and seconds, for random tissues."""

import time
from typing import Any

import common
import jax
import numpy as np

import jaxtissue as jt
from jaxtissue.meshes.cell_meshes import TOLERANCE, mesh_cells
from jaxtissue.topology.traced_sizes import trace_sizes

TUBES = ((20.0, 1.0, 10.0, 100), (100.0, 1.0, 10.0, 500), (100.0, 8.0, 10.0, 500))


def measured(length: float, apical_radius: float, basal_radius: float, cells: int) -> dict[str, Any]:
    """Errors relative to each cell's own volume; the sum relative to the tube's."""
    tube = jt.Tube(length, apical_radius, basal_radius)
    place = np.asarray(tube.random_positions(jax.random.key(0), cells), float)
    begin = time.perf_counter()
    meshes = mesh_cells(place, tube)
    seconds = time.perf_counter() - begin
    traced = trace_sizes(place, tube)
    assert traced is not None
    volumes = meshes.volumes()
    error = np.abs(volumes / traced.volume - 1)
    return {
        "sizes": [length, apical_radius, basal_radius],
        "cells": cells,
        "tolerance": TOLERANCE,
        "median_error": float(np.median(error)),
        "largest_error": float(error.max()),
        "sum_error": float(volumes.sum() / tube.volume - 1),
        "triangles": len(meshes.triangles),
        "seconds": seconds,
    }


if __name__ == "__main__":
    path = common.output((__doc__ or "").split("\n")[0], "meshes")
    common.write(path, {"tissues": [measured(*sizes) for sizes in TUBES]})
