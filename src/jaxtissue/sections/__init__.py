"""Sections: cells of any domain, measured as polygons on layers of constant height."""
