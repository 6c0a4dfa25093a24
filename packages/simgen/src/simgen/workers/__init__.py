"""Who computes: processes of this machine or a Dask cluster, and the line that tells how far they are."""
