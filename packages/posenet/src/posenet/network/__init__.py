"""The multi-task network: depth to features, regions, heads, hypotheses, registration, losses."""
