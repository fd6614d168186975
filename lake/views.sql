-- Views and macros for people. Tables are as in lake/tables.py; superseded rows are already left out.
CREATE MACRO trace(wanted) AS TABLE
SELECT unnest(time_s) AS time_s, unnest(lift_mm) AS lift_mm, unnest(force_n) AS force_n
FROM traces WHERE grasp_id = wanted;
