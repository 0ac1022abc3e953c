"""Scenes of a tissue, off screen: the whole of it, cut open or in bodies, or some cells with their neighbors.

Each function returns the PyVista plotter; `save` writes it as PNG.
"""

import math
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
from jaxtyping import Bool, Float, Int
from matplotlib.colors import to_rgb

from jaxtissue.meshes.cell_meshes import CellMeshes
from jaxtissue.meshes.coloring import PALETTE, spread_colors
from jaxtissue.pictures.bodies import body
from jaxtissue.pictures.outsides import Face
from jaxtissue.system.extras import optional

SIZE = 1200, 800
LINE, _LINE = "#222222", (34, 34, 34)
ALONG = np.array([1.0, 0, 0])
_LIGHT = {"ambient": 0.25, "diffuse": 0.8, "specular": 0.12, "specular_power": 15}


def shades(cells: int, pairs: Int[np.ndarray, "m 2"]) -> Int[np.ndarray, "n 3"]:
    """The color of each cell, 8 bits, that none of its neighbors has wherever eight colors suffice."""
    palette = np.array([[round(255 * part) for part in to_rgb(color)] for color in PALETTE], np.uint8)
    return palette[spread_colors(cells, pairs)]


def draw_tissue(faces: Sequence[Face], colors: Int[np.ndarray, "n 3"], unit: str | None = "") -> Any:
    """The tissue cut open by planes, so that the lumen and the walls within are seen.

    Args:
        faces: Its outside.
        colors: The color of each cell, 8 bits.
        unit: The unit of lengths, for the scale bar; None for a scene without one.
    """
    pyvista = _start()
    plotter = _plotter(pyvista)
    for face in faces:
        u, v = face.points.shape[:2]
        number = np.arange(u * v).reshape(u, v)
        quads = np.stack([number[:-1, :-1], number[1:, :-1], number[1:, 1:], number[:-1, 1:]], axis=-1)
        sheet = pyvista.PolyData.from_regular_faces(face.points.reshape(-1, 3), quads.reshape(-1, 4))
        across, along = np.meshgrid(np.linspace(0, 1, u), np.linspace(0, 1, v), indexing="ij")
        sheet.active_texture_coordinates = np.stack([along, 1 - across], axis=-1).reshape(-1, 2)
        texture = pyvista.numpy_to_texture(face.image(colors, _LINE))
        texture.interpolate = texture.mipmap = True
        plotter.add_mesh(sheet, texture=texture, smooth_shading=True, **_LIGHT)
        rim = np.concatenate([number[0], number[1:, -1], number[-1, -2::-1], number[-2::-1, 0]])
        lines = np.column_stack([np.full(len(rim) - 1, 2), rim[:-1], rim[1:]]).ravel()
        edge = pyvista.PolyData(face.points.reshape(-1, 3), lines=lines)
        plotter.add_mesh(edge, color=LINE, line_width=2.5, lighting=False)
    points = np.concatenate([face.points.reshape(-1, 3) for face in faces])
    return _look(plotter, pyvista, points, unit, (-0.5, -1.0, 0.75), (0.0, 0.0, 1.0))


def draw_bodies(
    meshes: CellMeshes, colors: Int[np.ndarray, "n 3"], cut: bool = True, apart: float = 0.0, unit: str = ""
) -> Any:
    """All cells of a tissue as bodies.

    Args:
        meshes: The meshes of its cells.
        colors: The color of each cell, 8 bits.
        cut: Whether a quarter of the cells is left out, so that the lumen and the walls within are seen.
        apart: How far cells are moved away from the middle, as a fraction of their distance from it.
        unit: The unit of lengths, for the scale bar.
    """
    pyvista = _start()
    plotter, middles = _plotter(pyvista), centers(meshes)
    chosen = np.ones(meshes.cells, bool)
    if cut:
        chosen = ~((middles[:, 1] < 0) & (middles[:, 2] > 0))
    middle = (meshes.points.min(axis=0) + meshes.points.max(axis=0)) / 2
    if apart:
        for cell in np.flatnonzero(chosen).tolist():
            _add(plotter, pyvista, meshes, _only(meshes, cell), colors, shift=apart * (middles[cell] - middle))
    else:
        _add(plotter, pyvista, meshes, chosen, colors)
    return _look(
        plotter, pyvista, middle + (1 + apart) * (meshes.points - middle), unit, (-0.5, -1.0, 0.75), (0.0, 0.0, 1.0)
    )


def draw_cells(
    meshes: CellMeshes,
    colors: Int[np.ndarray, "n 3"],
    cells: Sequence[int],
    around: Sequence[int] = (),
    points: Any = (),
    unit: str = "",
) -> Any:
    """Some cells in full color, others round them like glass, and points such as transition points as black balls."""
    pyvista = _start()
    plotter = _plotter(pyvista)
    for cell in cells:
        _add(plotter, pyvista, meshes, _only(meshes, cell), colors)
    for cell in around:
        _add(plotter, pyvista, meshes, _only(meshes, cell), colors, opacity=0.12)
    own = np.concatenate([meshes.cell(cell)[0] for cell in cells])
    middle, places = own.mean(axis=0), np.asarray(points, float).reshape(-1, 3)
    for place in places:
        plotter.add_mesh(pyvista.Sphere(radius=np.linalg.norm(np.ptp(own, axis=0)) / 40, center=place), color="black")
    outward = middle * [0, 1, 1]
    outward /= np.linalg.norm(outward) or 1
    side = places.mean(axis=0) - middle if len(places) else np.cross([1.0, 0, 0], outward) + 0.6 * ALONG
    side -= (side @ outward) * outward
    side /= np.linalg.norm(side) or 1
    shown = np.concatenate([meshes.cell(cell)[0] for cell in (*cells, *around)])
    return _look(plotter, pyvista, shown, unit, tuple(side + 0.3 * outward), tuple(outward))


def centers(meshes: CellMeshes) -> Float[np.ndarray, "n 3"]:
    """The mean place of the surface of each cell."""
    middle, area = meshes.points[meshes.triangles].mean(axis=1), np.linalg.norm(meshes.normals(), axis=1)
    n, found = meshes.cells, np.zeros((meshes.cells, 3))
    total = sum(np.bincount(side, area, n)[:n] for side in meshes.sides.T)
    for axis in range(3):
        found[:, axis] = sum(np.bincount(side, area * middle[:, axis], n)[:n] for side in meshes.sides.T) / total
    return found


def save(plotter: Any, path: Path) -> None:
    """Write a scene as PNG and close it."""
    plotter.screenshot(str(path))
    plotter.close()


def _start() -> Any:
    pyvista = optional("pyvista", "viz", "a picture in three dimensions")
    # without a display VTK tells that it takes another way
    logger = optional("vtkmodules.vtkCommonCore", "viz", "a picture").vtkLogger
    logger.SetStderrVerbosity(logger.VERBOSITY_OFF)
    return pyvista


def _plotter(pyvista: Any) -> Any:
    plotter = pyvista.Plotter(off_screen=True, window_size=list(SIZE), lighting="light kit")
    plotter.set_background("white")
    plotter.enable_anti_aliasing("msaa", multi_samples=4)
    plotter.add_axes(line_width=3, color="black", xlabel="x", ylabel="y", zlabel="z")
    return plotter


def _only(meshes: CellMeshes, cell: int) -> Bool[np.ndarray, " n"]:
    return np.arange(meshes.cells) == cell


def _add(
    plotter: Any,
    pyvista: Any,
    meshes: CellMeshes,
    chosen: Bool[np.ndarray, " n"],
    colors: np.ndarray,
    opacity: float = 1.0,
    shift: Any = (0, 0, 0),
) -> None:
    part = body(meshes, chosen)
    part = part._replace(points=part.points + np.asarray(shift, float))
    plotter.add_mesh(
        part.surface(pyvista, colors), scalars="color", rgb=True, smooth_shading=True, opacity=opacity, **_LIGHT
    )
    line = (LINE, 2.5) if opacity > 0.5 else ("#999999", 1.0)
    plotter.add_mesh(part.edges(pyvista), color=line[0], line_width=line[1], lighting=False)


def _look(
    plotter: Any,
    pyvista: Any,
    points: Float[np.ndarray, "p 3"],
    unit: str | None,
    toward: tuple[float, ...],
    up: tuple[float, ...],
) -> Any:
    """Look at the points from a direction, with a bar along x of a round length of about a quarter of them."""
    low, high = points.min(axis=0), points.max(axis=0)
    about = max((high - low).max() / 4, 1e-300)
    power = 10.0 ** math.floor(math.log10(about))
    length = max(step * power for step in (1, 2, 5) if step * power <= about)
    middle, above = (low + high) / 2, np.asarray(up)
    front = np.asarray(toward) - np.asarray(toward) @ above * above
    front /= np.linalg.norm(front)
    sink, near = (points - middle) @ above, (points - middle) @ front
    bar = middle + (sink.min() - 0.04 * np.ptp(sink)) * above + near.max() * front
    ends = bar - length / 2 * ALONG, bar + length / 2 * ALONG
    text, below = (
        f"{length:g} {unit or ('length unit' if length == 1 else 'length units')}",
        max(np.ptp(sink), 1.5 * about),
    )
    if unit is not None:
        plotter.add_mesh(pyvista.Line(*ends), color="black", line_width=5, lighting=False)
        plotter.add_point_labels([bar - 0.09 * below * above], [text], font_size=20,
                             bold=False, text_color="black", shape=None, show_points=False, always_visible=True,
                             justification_horizontal="center", justification_vertical="top")  # fmt: skip
    plotter.view_vector(toward, viewup=up)
    _fill(plotter.camera, np.concatenate([points, [bar - 0.12 * below * above], ends]))
    return plotter


def _fill(camera: Any, points: Float[np.ndarray, "p 3"]) -> None:
    """Turn the camera to the middle of the points, and let these fill the picture."""
    ahead = np.asarray(camera.focal_point) - camera.position
    ahead /= np.linalg.norm(ahead)
    right = np.cross(ahead, camera.up)
    right /= np.linalg.norm(right)
    axes = np.stack([right, np.cross(right, ahead)])
    seen = points @ axes.T
    for _ in range(3):  # nearer points are seen larger
        away = points - camera.position
        seen = away @ axes.T / (away @ ahead)[:, None]
        middle = (seen.min(axis=0) + seen.max(axis=0)) / 2
        shift = middle @ axes * (np.linalg.norm(np.asarray(camera.focal_point) - camera.position))
        camera.position, camera.focal_point = camera.position + shift, camera.focal_point + shift
    half = np.ptp(seen, axis=0) / 2
    camera.view_angle = math.degrees(2 * math.atan(max(half[1], half[0] * SIZE[1] / SIZE[0]) / 0.93))
