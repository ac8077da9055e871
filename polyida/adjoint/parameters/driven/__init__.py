"""Parameters of what is driven in time: profiles of motors, paths and loads, and what times that move do."""
