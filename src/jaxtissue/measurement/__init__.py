"""One cell's sizes: the quadrature, the lines parallel to the axis, the walls that bound them."""
