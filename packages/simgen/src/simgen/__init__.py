"""From a CAD mesh to labeled bin-picking depth images."""
