"""From a CAD mesh to labelled bin-picking depth images."""
