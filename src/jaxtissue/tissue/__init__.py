"""All cells of a tissue, measured once or again and again, doubtful ones traced."""
