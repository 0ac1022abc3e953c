"""Tissues as files that others open: images, meshes, tables and graphs."""
