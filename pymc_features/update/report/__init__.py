"""What is made of a result: verdict, tables, figures, the page, and what the command line says."""
