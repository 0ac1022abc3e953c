"""Pictures of tissues in three dimensions."""
