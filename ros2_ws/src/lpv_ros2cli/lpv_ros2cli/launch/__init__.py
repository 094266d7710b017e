"""Launch files in XML and YAML: reading, evaluating, running."""
