"""What people look at: pictures, TensorBoard, one-file HTML reports."""
