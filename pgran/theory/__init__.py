"""Closed forms, numpy only: waves in an infinite medium, turning wave vectors, the specimen."""
