"""What the project uses of astropy.io."""
