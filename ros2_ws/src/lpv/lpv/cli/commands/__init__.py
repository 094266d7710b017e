"""The commands of ``lpv``, one module each."""
