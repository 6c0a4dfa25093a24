"""What pictures and pages are made of: curves, charts, overlays, HTML; nothing here knows of scores."""
