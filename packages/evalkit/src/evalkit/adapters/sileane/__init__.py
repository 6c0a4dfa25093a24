"""The Siléane dataset (Brégier et al. 2017): its files as its evaluation toolbox reads them, and our frames in its format."""
