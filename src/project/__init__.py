"""Commands that make calls: notebooks, scans, README, site and benchmarks. No science in here."""
