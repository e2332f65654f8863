"""Results as people keep them: files, pages, pictures, JSON."""
