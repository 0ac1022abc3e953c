"""The names of the formats of exports, the units they may carry, and the names of pictures."""

FORMATS = ("ome-tiff", "vtu", "pvd", "ply", "stl", "glb", "graphml", "csv", "parquet", "anndata")
UNITS = ("nm", "um", "mm", "cm", "m")
VIEWED = ("tissue", "exploded", "cell", "scutoid", "internal", "surfaces", "movie")
