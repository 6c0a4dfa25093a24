"""From a mesh file, or a built-in name, to an object in metres: mending, units, convex parts."""
