"""Which cell contains a point: voxels and labels, point location, spread; and the exact path."""
