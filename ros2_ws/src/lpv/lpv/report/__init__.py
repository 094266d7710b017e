"""What all reports share: look of figures and pages, rendering into one self-contained file."""
