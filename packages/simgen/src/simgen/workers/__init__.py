"""Who computes: processes of this machine or a Dask cluster, and the line that shows how far they are."""
