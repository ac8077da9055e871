"""References of studies: by methods of unlike families, as well known as these agree, or what the user gives."""
