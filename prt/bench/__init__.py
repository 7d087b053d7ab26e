"""Run, results, tables, claims, charts, report. Names no method."""
