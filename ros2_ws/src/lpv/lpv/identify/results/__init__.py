"""What an identification gives: files, text, pictures, report."""
