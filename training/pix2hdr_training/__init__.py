"""Training of pix2hdr's networks, and the Python half of the weights format."""
