"""The program's jobs as functions: options in, a result out."""
