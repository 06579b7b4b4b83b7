"""Geo-EVS as the paper describes it."""
