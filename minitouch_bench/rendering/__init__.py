"""One kit for reports and board: tables, charts, cards and pages as data, and their writers."""
