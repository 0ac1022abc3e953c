"""Surface meshes of cells, which share their walls and tile the tissue, and the shapes of cells measured on them."""
