"""``prt report``: everything in ``reports/`` as one HTML file that opens from disk and asks no network.

``folders`` finds the reports; ``content`` reads one of them: ``markdown`` its texts and tables, ``verdicts``
its claims, ``measured`` its results.csv, ``svg`` its charts, ``pictures`` its images. ``page`` puts all of
them into one file, with the styles and scripts of ``assets/``.

Nothing that comes from a report is ever made into HTML: it travels as JSON, the page's script makes text
nodes of it, and a content-security policy runs that one script and lets nothing be fetched.
"""
