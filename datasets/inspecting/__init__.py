"""Looking at runs and exports: summary, HTML report, Rerun files, a browser window."""
