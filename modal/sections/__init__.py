"""What every page of a result says: the words and tables that report, recording and terminal share."""
