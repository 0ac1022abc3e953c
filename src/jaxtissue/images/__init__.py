"""Images of labels: measured as they are, and fitted by tissues."""
