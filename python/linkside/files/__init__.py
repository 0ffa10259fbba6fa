"""Files: tables of columns, and YAML in which an error names its line."""
