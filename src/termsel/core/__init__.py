"""What every room needs: errors, options, files, isolation of plugins, threads."""
