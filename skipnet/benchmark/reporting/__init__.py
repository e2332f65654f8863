"""What people read of a run: tables, figures, pages, TensorBoard."""
