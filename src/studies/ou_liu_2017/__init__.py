"""The sphere of Ou & Liu (2017)."""
