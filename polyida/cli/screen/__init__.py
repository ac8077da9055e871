"""What is printed: tables, progress, lines and documents."""
