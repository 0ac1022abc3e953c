"""What a tissue is made in: backbones, the tube, and the one gate for positions."""
