"""Rollouts and worlds as pictures, films, USD, browser pages and live windows."""
