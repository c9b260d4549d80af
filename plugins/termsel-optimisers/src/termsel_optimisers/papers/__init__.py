"""A solver and set-ups of papers on the selection of terms.

References
----------
Valadan Zoej, Mansourian, Mojaradi and Sadeghian 2002; Zakaryaie Nejad, Ezzatpanah and Ramezani
2015; Yavari, Valadan Zoej and Salehi 2018; Akhoundi Khezrabad, Valadan Zoej and Safdarinezhad 2020.
"""
