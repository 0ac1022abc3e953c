"""Contacts of cells: traced edges, contacts with areas, transition points, statistics."""
