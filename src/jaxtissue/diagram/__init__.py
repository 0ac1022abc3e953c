"""The cell that holds a point: voxels and their labels, point location, spread; and the exact path."""
