"""Features of the lake's traces: qualities, identification, anomalies."""
