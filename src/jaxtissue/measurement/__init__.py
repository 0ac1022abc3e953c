"""The sizes of a cell: the quadrature, the lines parallel to the axis, and the walls that bound them."""
