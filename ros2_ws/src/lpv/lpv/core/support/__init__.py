"""What every module needs: files, errors, compilation, records."""
