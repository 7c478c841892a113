"""The sheet of EMVA Standard 1288, release 4.0 (2021): the parts *Linear* and *General*, with
intervals."""
