"""The names of the formats of exports, and the units they may carry."""

FORMATS = ("ome-tiff", "vtu", "pvd", "ply", "stl", "glb", "graphml", "csv", "parquet", "anndata")
UNITS = ("nm", "um", "mm", "cm", "m")
