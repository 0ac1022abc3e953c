"""Who owns which point: voxels and their labels, point location, spread; the exact path."""
