"""What training images might have been: seen by another depth camera, or only in part."""
