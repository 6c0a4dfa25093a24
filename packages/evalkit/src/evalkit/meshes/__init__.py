"""From a mesh file to vertices and faces in meters."""
