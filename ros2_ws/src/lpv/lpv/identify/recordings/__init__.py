"""Recordings of an arm, and motion on a uniform grid."""
