"""The geometry of a tissue: backbones, the tube, and the one gate for positions."""
