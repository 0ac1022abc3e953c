"""Label images: measuring them, and fitting tissues to them."""
