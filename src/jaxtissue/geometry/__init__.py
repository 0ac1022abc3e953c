"""The geometry of a tissue: backbones, the tube and other domains, and the checks of positions."""
