import json,sys,numpy as np
from scipy.stats import spearmanr
rows=[json.loads(l) for l in open(sys.argv[1])]
rng=np.random.default_rng(0)
acc={k:[] for k in ("predicted","analytic","oracle","mix","random","hindsight")}
sp=[];sa=[];sh=[]
for r in rows:
    a=np.array(r["achieved"]);b=np.array(r["before"]);s=np.array(r["seconds"])
    pr=np.log(r["present"]/np.array(r["predicted"]))/s
    g=np.array(r["guess"])
    R=lambda idx: (np.log(b[idx].mean()/a[idx].mean(axis=0)))/s
    per={k:[] for k in acc}
    n=len(b)
    c=[];h=[];ga=[]
    for _ in range(40):
        perm=rng.permutation(n); A,B=perm[:n//2],perm[n//2:]
        ra,rb=R(A),R(B)
        per["predicted"].append(rb[np.argmax(pr)]); per["analytic"].append(rb[np.argmax(g)]); per["oracle"].append(rb[np.argmax(ra)])
        per["mix"].append(rb[np.argmax(ra/ra.std()+pr/pr.std())]); per["random"].append(rb.mean()); per["hindsight"].append(rb.max())
        h.append(spearmanr(ra,rb)[0])
    full=R(np.arange(n))
    sp.append(spearmanr(pr,full)[0]); sa.append(spearmanr(g,full)[0]); sh.append(np.mean(h))
    for k in acc: acc[k].append(np.mean(per[k]))
print(len(rows),"scenes; spearman of rate with achieved(all): predicted",np.round(np.mean(sp),2),"analytic",np.round(np.mean(sa),2),"half-half",np.round(np.mean(sh),2))
m=np.array([acc[k] for k in acc])
for k,v in zip(acc,m): 
    bs=[v[i].mean()/m[0][i].mean() for i in (rng.integers(0,len(rows),len(rows)) for _ in range(1000))]
    print(k, np.round(v.mean(),3),"ratio to PredictScans",np.round(v.mean()/m[0].mean(),2),np.round(np.quantile(bs,[.025,.975]),2))
