"""Instances that fall into a bin until they rest."""
