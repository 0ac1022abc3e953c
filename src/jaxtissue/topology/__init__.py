"""Who touches whom: traced edges, contacts with areas, transitions, statistics."""
