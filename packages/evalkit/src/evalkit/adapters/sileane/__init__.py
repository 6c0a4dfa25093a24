"""The Siléane dataset (Brégier et al. 2017): its files as its toolbox reads them, and our frames in its format."""
