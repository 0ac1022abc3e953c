"""The backbones that can bound each cell: lists, complete by an exact sum, and shortlists for a span of sweeps."""
