"""Export of tissues to file formats of other programs: images, meshes, tables and graphs."""
