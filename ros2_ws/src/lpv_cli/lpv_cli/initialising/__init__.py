"""``lpv init``: files of an arm to start from, two links or n joints, out of a URDF."""
