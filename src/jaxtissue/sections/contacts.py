"""Contacts between cells on each layer, from the edges of their sections."""

from typing import NamedTuple

import numpy as np
from jaxtyping import Float, Int

from jaxtissue.sections.sizes import Sections


class LayerContacts(NamedTuple):
    """The contacts of cells on layers.

    Attributes:
        layer: The number of the layer of each, [m].
        pairs: The two cells a < b, [m, 2].
        length: The length of their edge, the mean of what both cells have measured, [m].
    """

    layer: Int[np.ndarray, " m"]
    pairs: Int[np.ndarray, "m 2"]
    length: Float[np.ndarray, " m"]


def layer_contacts(sections: Sections, lists: Int[np.ndarray, "q n"]) -> LayerContacts:
    """The contacts on all layers of sections that were measured on these lists, in order of layers and cells."""
    q, n = lists.shape
    line = np.asarray(sections.line)
    slot, layer, cell = np.nonzero(np.asarray(sections.is_edge) & (line < q))
    other = lists[line[slot, layer, cell], cell] % n
    low, high = np.minimum(cell, other), np.maximum(cell, other)
    keys, row = np.unique((layer * n + low) * n + high, return_inverse=True)
    length = np.bincount(row, np.asarray(sections.length, float)[slot, layer, cell] / 2, len(keys))
    first, second = np.divmod(keys, n)
    real = first % n != second  # a cell may touch its own copy
    return LayerContacts(*(part[real] for part in (first // n, np.stack([first % n, second], axis=1), length)))
