"""How far one cell leads over another at a point, in float64: what the diagram's edges are solved from.

With h = y cos t_j + z sin t_j and the foot of cell j at radius s = max(h, R_a), its squared distance is
d_j^2 = |p|^2 - 2 x x_j + x_j^2 - s (2 h - s). So the *lead* of j over a, d_a^2 - d_j^2, has the continuous
gradient 2 (q_j - q_a), q the feet: lead / |gradient| is the distance to their wall, to first order. The four
bounds of the tissue count as cells n .. n + 3: apical, basal, x = 0 and x = L, with leads R_a^2 - r^2,
r^2 - R_b^2, -x and x - L. An edge is where three labels lead equally, a vertex where four do. Label rows are
sorted, so that a bound is never the first.
"""

import numpy as np
from jaxtyping import ArrayLike, Float, Int

from jaxtissue.tube import Tube

BOUNDS = 4
TINY = 1e-300
BLOCK = 256  # points compared at once with all their rivals: what fits the processor's cache
BEND = 0.2  # the most that edges and walls turn against each other in a step: more than arccos(TURN) / 2


class Leads:
    """Leads of the labels of one tissue; points [m, 3], label rows [m, k].

    `rivals`, candidates of each cell [n, candidates], are those among whom the foremost is looked for.
    """

    def __init__(self, positions: ArrayLike, tube: Tube, rivals: np.ndarray | None = None) -> None:
        axial, angle = np.pad(np.asarray(positions, float).T, ((0, 0), (0, BOUNDS)))
        self.count, self.axial = len(axial) - BOUNDS, axial
        self.direction = np.stack([np.cos(angle), np.sin(angle)], axis=-1)
        self.inner, self.outer = float(tube.apical_radius), float(tube.basal_radius)
        self.length = float(tube.length)
        self.size = self.length + self.outer
        own = np.arange(self.count)
        self.rivals = own[:, None] if rivals is None else rivals
        turned = self.direction[self.rivals] - self.direction[own, None]
        rival, own = axial[self.rivals], axial[own, None]
        self._pairs = rival - own, rival + own, *np.moveaxis(turned, -1, 0), (turned**2).sum(axis=-1)

    def over_first(
        self, point: Float[np.ndarray, "m 3"], labels: Int[np.ndarray, "m k"]
    ) -> tuple[np.ndarray, np.ndarray]:
        """Leads of all labels but the first over the first, [m, k - 1], and their gradients [m, k - 1, 3]."""
        own, labels, point = labels[:, :1], labels[:, 1:], point[:, None]
        turned = self.direction[labels] - self.direction[own]
        height = (point[..., 1:] * self.direction[own]).sum(axis=-1)
        turn = (point[..., 1:] * turned).sum(axis=-1)
        foot, own_foot = np.maximum(height + turn, self.inner), np.maximum(height, self.inner)
        gap, rise = self.axial[labels] - self.axial[own], foot - own_foot
        # written in differences: loses no digits where the cells are close
        lead = gap * (2 * point[..., 0] - self.axial[labels] - self.axial[own])
        lead += rise * (2 * height - foot - own_foot) + 2 * foot * turn
        across = foot[..., None] * turned + rise[..., None] * self.direction[own]
        slope = 2 * np.concatenate([gap[..., None], across], axis=-1)
        row, column = np.nonzero(labels >= self.count)
        for bound in range(BOUNDS) if len(row) else ():
            at = labels[row, column] == self.count + bound
            here = row[at], column[at]
            lead[here], slope[here] = self._over_bound(bound, point[row[at], 0])
        return lead, slope

    def _over_bound(self, bound: int, point: Float[np.ndarray, "m 3"]) -> tuple[np.ndarray, np.ndarray]:
        outward = (-1.0, 1.0)[bound % 2]
        if bound < 2:
            square = (point[:, 1:] ** 2).sum(axis=1) - (self.inner, self.outer)[bound] ** 2
            return outward * square, outward * 2 * point * [0, 1, 1]
        return outward * (point[:, 0] - (0, self.length)[bound - 2]), np.tile(
            [outward, 0, 0], (len(point), 1)
        )

    def tangent(
        self, point: Float[np.ndarray, "m 3"], labels: Int[np.ndarray, "m 3"]
    ) -> Float[np.ndarray, "m 3"]:
        """Unit tangents of edges, along the cross product of the two gradients."""
        slope = self.over_first(point, labels)[1]
        cross = np.cross(slope[:, 0], slope[:, 1])
        return cross / np.maximum(np.linalg.norm(cross, axis=-1, keepdims=True), TINY)

    def solve(
        self, point: Float[np.ndarray, "m 3"], labels: Int[np.ndarray, "m k"], turns: int
    ) -> tuple[Float[np.ndarray, "m 3"], Float[np.ndarray, " m"]]:
        """Where four labels lead equally, or three and nearest to the point, by Newton; and the last step."""
        step = np.zeros_like(point)
        for _ in range(turns):
            lead, slope = self.over_first(point, labels)
            norm = np.maximum(np.linalg.norm(slope, axis=-1), TINY)
            rows, side = slope / norm[..., None], lead / norm
            if rows.shape[1] == 2:
                rows = np.append(rows, np.cross(rows[:, :1], rows[:, 1:]), axis=1)
                side = np.append(side, np.zeros_like(side[:, :1]), axis=1)
            dual = np.cross(rows[:, [1, 2, 0]], rows[:, [2, 0, 1]])
            volume = (rows[:, 0] * dual[:, 0]).sum(axis=-1)
            volume = np.where(np.abs(volume) > 1e-12, volume, np.nan)  # parallel walls don't meet
            step = (dual * side[..., None]).sum(axis=1) / volume[:, None]
            point = point - step
        return point, np.abs(step).max(axis=-1, initial=0)

    def foremost(
        self,
        point: Float[np.ndarray, "m 3"],
        labels: Int[np.ndarray, "m k"],
        ahead: Float[np.ndarray, "m 3"],
    ) -> tuple[Int[np.ndarray, " m"], Float[np.ndarray, " m"], Float[np.ndarray, " m"]]:
        """The label, beside the given ones, that leads most, the distance gone beyond its wall (negative: to
        go), and how far one may go `ahead` before an unseen wall could be crossed and crossed back."""
        parts = [
            self._foremost(point[at : at + BLOCK], labels[at : at + BLOCK], ahead[at : at + BLOCK])
            for at in range(0, max(len(point), 1), BLOCK)
        ]
        label, beyond, safe = (np.concatenate(part) for part in zip(*parts, strict=True))
        return label, beyond, safe

    def _foremost(self, point: np.ndarray, labels: np.ndarray, ahead: np.ndarray) -> tuple[np.ndarray, ...]:
        own = labels[:, 0]
        (x, y, z), (along_x, along_y, along_z) = point.T[..., None], ahead.T[..., None]
        rivals = self.rivals[own]
        gap, middle, turned_y, turned_z, chord = (table[own] for table in self._pairs)
        cosine, sine = self.direction[own].T[..., None]
        height = y * cosine + z * sine
        own_foot = np.maximum(height, self.inner)
        turn = y * turned_y + z * turned_z
        foot = np.maximum(height + turn, self.inner)
        rise = foot - own_foot
        lead = gap * (2 * x - middle) + rise * (2 * height - foot - own_foot) + 2 * foot * turn
        norm = 2 * np.sqrt(gap**2 + rise**2 + foot * own_foot * chord) + TINY
        rate = gap * along_x + rise * (along_y * cosine + along_z * sine)
        rate += foot * (turned_y * along_y + turned_z * along_z)
        beyond, rate = lead / norm, 2 * rate / norm

        bounds = np.tile(self.count + np.arange(BOUNDS), (len(own), 1))
        lead, slope = self.over_first(point, np.append(own[:, None], bounds, axis=1))
        norm = np.linalg.norm(slope, axis=-1) + TINY
        rivals, beyond = np.append(rivals, bounds, axis=1), np.append(beyond, lead / norm, axis=1)
        rate = np.append(rate, np.einsum("mkj,mj->mk", slope, ahead) / norm, axis=1)
        for column in labels.T[:, :, None]:
            beyond[rivals == column] = -np.inf
        first, rows = beyond.argmax(axis=1), np.arange(len(own))
        # 1.5: one step passes a wall that is met head-on
        safe = 1.5 * np.maximum(-beyond, 0) / (np.maximum(rate, 0) + BEND)
        safe = np.where(rate > -BEND, safe, np.inf).min(axis=1)
        return rivals[rows, first], beyond[rows, first], safe
