"""The names of the formats of exports, the units they may carry, and the names of pictures."""

FORMATS = ("ome-tiff", "ome-zarr", "vtu", "pvd", "ply", "stl", "glb", "graphml", "csv", "parquet", "anndata")
IMAGES = ("ome-tiff", "ome-zarr")  # of these, what has voxels, and takes --spacing
UNITS = ("nm", "um", "mm", "cm", "m")
VIEWED = ("tissue", "bodies", "exploded", "cell", "scutoid", "internal", "surfaces", "movie", "turntable")
MOVIES = ("movie", "turntable")  # of these, what moves
LEFT = ("tissue", "scutoid")  # those that each run leaves
OF_CELLS = ("cell", "scutoid", "internal")  # of these, the pictures of one cell that may be chosen


def picture_name(what: str) -> str:
    """The name of the file of a picture."""
    return f"{what}.{'gif' if what in MOVIES else 'png'}"
