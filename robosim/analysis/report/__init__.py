"""A report on an evaluation: page, tables and figures in a folder."""
