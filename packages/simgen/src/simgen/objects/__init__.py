"""From a mesh file, or a built-in name, to an object in meters: mending, units, convex parts."""
