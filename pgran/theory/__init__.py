"""Closed forms, numpy alone: waves in an infinite medium, turning wave vectors, the specimen."""
