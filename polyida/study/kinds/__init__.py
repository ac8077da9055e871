"""Ready kinds of study: rows of work against error, of errors against h, of condition numbers against h."""
