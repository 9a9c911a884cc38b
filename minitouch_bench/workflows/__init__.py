"""The program's jobs as functions: settings in, results out."""
