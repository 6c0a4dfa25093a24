"""The policy of units, which is evalkit's."""

from evalkit.meshes.units import check_size, decide_units

__all__ = ["check_size", "decide_units"]
