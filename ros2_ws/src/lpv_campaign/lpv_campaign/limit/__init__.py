"""The best that any estimator could do, and estimators that come close."""
