"""What was built, to look at: contact sheets, pages, histograms, a scene in 3D."""
